"""The controller: sensors, a goal and heights in, joint targets out, 50 times a second. NumPy and onnxruntime only."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from arrive.deployment.command import JointCommand
from arrive.deployment.faults import BadInput, Fallen
from arrive.deployment.goals import Goal, Joystick, Navigator, Order
from arrive.deployment.heights import GridHeights, HeightMap, HeightSampler, PointCloud
from arrive.deployment.inputs import Frame, Sensors, frame_of
from arrive.deployment.log import ControlLog
from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.deployment.safety import DEFAULT, Limits, Safety
from arrive.deployment.terms import COMPUTED, Moment, check_observed_terms
from arrive.deployment.watchdog import Watchdog
from arrive.rotation import heading, matrix

LARGEST_OBSERVATION = 100.0
"""A scaled observation beyond this is implausible. In training they are of order 1."""
LARGEST_ACTION = 40.0
"""An action beyond this is implausible. Policies on their hardest terrain reach 16."""
LARGEST_STEP_S = 0.1
"""Largest time by which the safe stance advances in one step, even if the step comes late [s]."""


class Controller:
    """Runs an exported policy.

    On a bad input (stale, not finite, implausible, of the wrong size, or no goal) it goes to the safe stance: joint
    targets jump to the current joint positions, so that only the drives' damping acts, and then move slowly to the
    default pose. If the robot has fallen, they stay at the current joint positions. The policy takes over again once
    all inputs have been good for `Safety.recover_s`.
    """

    def __init__(self, policy: PolicyFile, safety: Safety = DEFAULT, log: ControlLog | None = None):
        """Prepare everything that does not change.

        Args:
            log: records every step, if given.

        Raises:
            ArriveError: the policy needs an observation that this controller cannot provide.
        """
        check_observed_terms(policy)
        self.policy, self.safety = policy, safety
        robot = policy.robot
        self._default = np.array(robot.default_joint_pos_rad)
        self._scale = np.concatenate([np.full(term.stop - term.start, term.scale) for term in policy.terms])
        self._terms = [COMPUTED[term.name].compute for term in policy.terms]
        self._grid = HeightSampler(policy.grid)
        self._limits = Limits(robot)
        self._navigator = Navigator(policy.task)
        self._watchdog = Watchdog(robot, len(self._grid.points), policy.period_s, safety)
        self.log: ControlLog | None = None
        self._rehearse()
        self.log = log

    @classmethod
    def load(cls, path: Path | str, safety: Safety = DEFAULT, log: ControlLog | None = None) -> "Controller":
        """Read an exported policy.

        Raises:
            ArriveError: see `read_policy_file`.
        """
        return cls(read_policy_file(path), safety, log)

    def _rehearse(self) -> None:
        """Take one step of a standing robot and forget it.

        The first step prepares tables and takes 10 to 30 ms, more than half a control period. A robot must not wait for
        it.
        """
        self.reset()
        robot = self.policy.robot
        none = np.zeros(3)
        pos_w = np.array([0.0, 0.0, robot.standing_height_m])
        standing = Sensors(
            self._default, np.zeros(len(self._default)), pos_w, np.array([1.0, 0.0, 0.0, 0.0]), none, none, 0.0
        )
        self.step(standing, Joystick(forward=0.0, left=0.0), GridHeights(np.zeros(len(self._grid.points)), 0.0), 0.0)
        self.reset()

    def reset(self) -> None:
        """Start again, as after switching on."""
        self._navigator.reset()
        self._watchdog.reset()
        self._action = np.zeros(len(self._default))
        self._known_pos: np.ndarray | None = None
        self._held: np.ndarray | None = None
        self._blind = False
        self._good_since_s: float | None = None
        self._last_now_s: float | None = None

    def step(
        self, sensors: Sensors, goal: Goal | None, terrain: GridHeights | HeightMap | PointCloud, now_s: float
    ) -> JointCommand:
        """One control step, to be called every `policy.period_s`. It never raises because of its arguments.

        Args:
            now_s: current time on a clock that never goes back [s].
        """
        # Divisions and overflows caused by absurd inputs are found by the checks, so no warnings are needed.
        with np.errstate(all="ignore"):
            return self.step_frame(frame_of(sensors, goal, terrain, now_s, self._grid))

    def step_frame(self, frame: Frame) -> JointCommand:
        """One control step from inputs in the form in which they are logged."""
        with np.errstate(all="ignore"):
            verdict = self._watchdog.judge(frame)
            try:
                if verdict.fault is not None:
                    raise verdict.fault
                command = self._resume(frame, *self._attempt(frame))
            except BadInput as fault:
                command = self._fall_back(frame, fault, verdict.sensors_good)
        if np.isfinite(frame.now_s):
            self._last_now_s = frame.now_s
        if self.log is not None:
            self.log.append(self.policy, frame, command)
        return command

    def observe(self, frame: Frame) -> tuple[np.ndarray, Order]:
        """The network's input (observations,), and the command in it, for a frame that the watchdog has accepted.

        Raises:
            BadInput: the goal is not usable, too little of the ground is seen, or ground and base are in different
                frames.
        """
        pos, safety = frame.base_pos_w, self.safety
        standing = self.policy.robot.standing_height_m
        heights, seen = self._grid.fill(frame.heights_w.astype(np.float64), pos[2] - standing)
        if seen < safety.least_seen:
            raise BadInput(f"only {seen:.0%} of the ground was seen")
        ground = _median(heights)
        if not abs(pos[2] - standing - ground) <= safety.ground_m:
            raise BadInput(
                f"the base is {pos[2] - ground:.3g} m above the ground: are base_pos_w and the heights in one frame "
                "and in metres?"
            )
        quat = frame.base_quat_w / np.linalg.norm(frame.base_quat_w)
        order = self._navigator.order(frame.goal, pos, heading(quat), ground, frame.now_s)
        if seen < 1.0:
            order = order._replace(reason=", ".join(filter(None, (order.reason, f"{seen:.0%} of the ground seen"))))
        moment = Moment(self.policy, frame, matrix(quat), order, self._action, heights, self._default)
        return np.concatenate([compute(moment) for compute in self._terms]) * self._scale, order

    def _attempt(self, frame: Frame) -> tuple[Order, np.ndarray]:
        observation, order = self.observe(frame)
        if not np.abs(observation).max() <= LARGEST_OBSERVATION:
            worst = int(np.argmax(~(np.abs(observation) <= LARGEST_OBSERVATION)))
            name = next(term.name for term in self.policy.terms if term.start <= worst < term.stop)
            raise BadInput(f"{name} is implausibly large")
        action = self.policy.act(observation[None].astype(np.float32))[0].astype(np.float64)
        if not np.abs(action).max() <= LARGEST_ACTION:
            raise BadInput("the network's output is implausibly large or not finite")
        return order, action

    def _resume(self, frame: Frame, order: Order, action: np.ndarray) -> JointCommand:
        """Act, unless the last fault was too recent."""
        if self._held is not None:
            self._good_since_s = frame.now_s if self._good_since_s is None else self._good_since_s
            # A microsecond of tolerance, so that rounding of times does not cost a step.
            if frame.now_s - self._good_since_s < self.safety.recover_s - 1e-6:
                return self._safe(frame, "recovering", sensors_good=True)
            self._held, self._good_since_s = None, None
        self._action, self._known_pos = action, frame.joint_pos
        targets = self._default + self.policy.robot.action_scale_rad * action
        return JointCommand(
            self._limits.within_torque(targets, frame.joint_pos, frame.joint_vel), order.mode, order.reason
        )

    def _fall_back(self, frame: Frame, fault: BadInput, sensors_good: bool) -> JointCommand:
        self._good_since_s = None
        self._navigator.release()
        if not isinstance(fault, Fallen):
            return self._safe(frame, str(fault), sensors_good)
        # Legs that move to the default pose would throw a robot that lies on its back.
        self._known_pos, self._held = frame.joint_pos, None
        return replace(self._safe(frame, str(fault), sensors_good), mode="fallen")

    def _safe(self, frame: Frame, reason: str, sensors_good: bool) -> JointCommand:
        """Advance the safe stance by one step.

        It starts at the last known joint positions, or at the default pose if there are none. It starts again as soon
        as joint positions arrive.
        """
        if sensors_good:
            self._known_pos = frame.joint_pos
        if self._held is None or (self._blind and sensors_good):
            self._blind = not sensors_good
            self._held = self._limits.within_joints(self._default if self._known_pos is None else self._known_pos)
        else:
            reach = self.safety.glide_rad_s * self._elapsed_s(frame)
            self._held = self._held + np.clip(self._default - self._held, -reach, reach)
        # The policy observes as its last action the one that the robot carries out.
        self._action = (self._held - self._default) / self.policy.robot.action_scale_rad
        targets = self._held.copy()
        if sensors_good:
            targets = self._limits.within_torque(targets, frame.joint_pos, frame.joint_vel)
        return JointCommand(targets, "safe", reason)

    def _elapsed_s(self, frame: Frame) -> float:
        """Time since the last step [s]; one period if the clock is unusable."""
        if self._last_now_s is None or not np.isfinite(frame.now_s):
            return self.policy.period_s
        return min(max(frame.now_s - self._last_now_s, 0.0), LARGEST_STEP_S)


def _median(values: np.ndarray) -> float:
    """Like `np.median` for values without NaN, ten times as fast."""
    half, odd = divmod(len(values), 2)
    ordered = np.sort(values)
    return float(ordered[half] if odd else (ordered[half - 1] + ordered[half]) / 2)
