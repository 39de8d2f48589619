"""The controller: sensors, a goal and heights in, joint targets out, 50 times a second. NumPy and onnxruntime only."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from arrive.deployment.command import JointCommand
from arrive.deployment.faults import BadInput, Fallen
from arrive.deployment.goals import Goal, Navigator, Order
from arrive.deployment.heights import GridHeights, HeightGrid, HeightMap, PointCloud
from arrive.deployment.inputs import Frame, Sensors, frame_of
from arrive.deployment.log import ControlLog
from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.deployment.rotation import heading, matrix
from arrive.deployment.safety import DEFAULT, Limits, Safety
from arrive.deployment.terms import COMPUTED, Moment, check_terms
from arrive.deployment.watchdog import Watchdog

LARGEST_OBSERVATION = 100.0
"""A scaled observation beyond this is implausible; in training they are of order 1."""
LARGEST_ACTION = 40.0
"""An action beyond this is implausible; policies on their hardest terrain give up to 16."""
LARGEST_STEP_S = 0.1
"""The safe stance moves by no more than this much time in one step, however late the step comes [s]."""


class Controller:
    """Runs an exported policy.

    On an input it must not act on (stale, non-finite, impossible, of the wrong size, no goal) it goes to the safe
    stance: joint targets jump to where the joints are, so that only the drives' damping acts, and glide from there to
    the default pose. While the robot has fallen, they stay where the joints are. The policy takes over again once all
    inputs have been good for `Safety.recover_s`.
    """

    def __init__(self, policy: PolicyFile, safety: Safety = DEFAULT, log: ControlLog | None = None):
        """Prepare everything that does not change.

        Args:
            log: takes down every step, if given.

        Raises:
            ArriveError: the policy needs an observation that this controller cannot provide.
        """
        check_terms(policy)
        self.policy, self.safety, self.log = policy, safety, log
        robot = policy.robot
        self._default = np.array(robot.default_joint_pos_rad)
        self._scale = np.concatenate([np.full(term.stop - term.start, term.scale) for term in policy.terms])
        self._terms = [COMPUTED[term.name].compute for term in policy.terms]
        self._grid = HeightGrid(policy.grid)
        self._limits = Limits(robot)
        self._navigator = Navigator(policy.task)
        self._watchdog = Watchdog(robot, len(self._grid.points), policy.period_s, safety)
        self.reset()

    @classmethod
    def load(cls, path: Path | str, safety: Safety = DEFAULT, log: ControlLog | None = None) -> "Controller":
        """Read an exported policy.

        Raises:
            ArriveError: see `read_policy_file`.
        """
        return cls(read_policy_file(path), safety, log)

    def reset(self) -> None:
        """Start afresh, as after switching on."""
        self._navigator.reset()
        self._watchdog.reset()
        self._action = np.zeros(len(self._default))
        self._known_pos: np.ndarray | None = None
        self._held: np.ndarray | None = None
        self._blind = False
        self._good_since_s: float | None = None
        self._last_now_s: float | None = None

    def step(
        self, sensors: Sensors, goal: Goal, terrain: GridHeights | HeightMap | PointCloud, now_s: float
    ) -> JointCommand:
        """One control step; call it every `policy.period_s`. It never raises because of what its arguments hold.

        Args:
            now_s: present time on a clock that never goes back [s].
        """
        # Divisions and overflows of absurd inputs end in the checks, not in warnings.
        with np.errstate(all="ignore"):
            return self.step_frame(frame_of(sensors, goal, terrain, now_s, self._grid))

    def step_frame(self, frame: Frame) -> JointCommand:
        """One control step from inputs in their logged shape."""
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
        """The network's input (observations,) and the command in it, of a frame that the watchdog let pass.

        Raises:
            BadInput: no usable goal, too little ground seen, or ground in another frame than the base.
        """
        pos, safety = frame.base_pos_w, self.safety
        standing = self.policy.robot.standing_height_m
        heights, seen = self._grid.fill(frame.heights_w, pos[2] - standing)
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
        """Act, unless a fault was too short a time ago."""
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
        # Legs that go to the default pose would throw a robot about that lies on its back.
        self._known_pos, self._held = frame.joint_pos, None
        return replace(self._safe(frame, str(fault), sensors_good), mode="fallen")

    def _safe(self, frame: Frame, reason: str, sensors_good: bool) -> JointCommand:
        """The safe stance, one step further.

        It begins where the joints were last seen, or in the default pose if they never were, and once more as soon as
        they are seen.
        """
        if sensors_good:
            self._known_pos = frame.joint_pos
        if self._held is None or (self._blind and sensors_good):
            self._blind = not sensors_good
            self._held = self._limits.within_joints(self._default if self._known_pos is None else self._known_pos)
        else:
            reach = self.safety.glide_rad_s * self._elapsed_s(frame)
            self._held = self._held + np.clip(self._default - self._held, -reach, reach)
        # The action that the policy sees as its last is the one the robot is carrying out.
        self._action = (self._held - self._default) / self.policy.robot.action_scale_rad
        targets = self._held.copy()
        if sensors_good:
            targets = self._limits.within_torque(targets, frame.joint_pos, frame.joint_vel)
        return JointCommand(targets, "safe", reason)

    def _elapsed_s(self, frame: Frame) -> float:
        """Since the step before, one period where the clock cannot tell."""
        if self._last_now_s is None or not np.isfinite(frame.now_s):
            return self.policy.period_s
        return min(max(frame.now_s - self._last_now_s, 0.0), LARGEST_STEP_S)


def _median(values: np.ndarray) -> float:
    """Like `np.median` of numbers without NaN, in a tenth of its time."""
    half, odd = divmod(len(values), 2)
    ordered = np.sort(values)
    return float(ordered[half] if odd else (ordered[half - 1] + ordered[half]) / 2)
