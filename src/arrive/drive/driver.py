"""The deployment controller on a simulated robot: single control steps, and the reset after a fall."""

from dataclasses import dataclass

from arrive.deployment import Controller, Goal, JointCommand
from arrive.simulation import SimulatedRobot


@dataclass(frozen=True, eq=False)
class Step:
    """Result of one control step."""

    command: JointCommand
    failure: str
    """Why the robot must be put back to the start; empty if it can continue."""


class Driver:
    """A controller on a simulated robot.

    A robot that crashes, falls or leaves the ground is put back to its start. The controller then gets no goal for one
    step, so that it goes to its safe stance and recovers as on a real robot.
    """

    def __init__(self, robot: SimulatedRobot, controller: Controller):
        """Use a new robot at its start, and a new controller."""
        self.robot, self.controller = robot, controller
        self.time_s = 0.0
        """Simulated time; unlike the robot's own clock it never goes back [s]."""
        self.falls = 0
        """Number of times the robot was put back."""
        self._failed = False

    @property
    def control_dt(self) -> float:
        """Simulated time of a step [s]."""
        return self.robot.control_dt

    def step(self, goal: Goal) -> Step:
        """Make one control step towards a goal."""
        robot, now_s = self.robot, self.time_s
        told = None if self._failed else goal
        command = self.controller.step(robot.sensors(now_s), told, robot.height_map(now_s), now_s)
        robot.step(command.targets)
        self.time_s += robot.control_dt
        failure = failure_of(robot)
        self._failed = bool(failure)
        return Step(command, failure)

    def put_back(self) -> None:
        """Put a robot that failed back to its start."""
        self.falls += 1
        self.robot.reset()

    def restart(self, robot: SimulatedRobot | None = None, controller: Controller | None = None) -> None:
        """Start again, with another robot or controller if given. Time and falls are kept."""
        self.robot, self.controller = robot or self.robot, controller or self.controller
        self.robot.reset()
        self.controller.reset()
        self._failed = False


def failure_of(robot: SimulatedRobot) -> str:
    """Why a robot cannot continue; empty if it can."""
    if robot.fell:
        return "fell into a hole"
    if robot.crashed:
        return "fell over: its base touched something"
    return "walked off the edge of the ground" if robot.left_ground else ""
