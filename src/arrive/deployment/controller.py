"""The controller: sensors, a goal and heights in, joint targets out, 50 times a second. NumPy and onnxruntime only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from arrive.deployment.goals import Goal, Navigator, Order
from arrive.deployment.heights import GridHeights, HeightGrid, HeightMap, PointCloud
from arrive.deployment.inputs import Frame, Sensors, frame_of
from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.deployment.rotation import heading, matrix
from arrive.deployment.safety import DEFAULT, BadInput, Limits, Safety, check_sensors, check_terrain
from arrive.errors import unknown_name

if TYPE_CHECKING:
    from arrive.deployment.log import ControlLog

KNOWN_TERMS = (
    "base_lin_vel",
    "base_ang_vel",
    "gravity",
    "target",
    "time_left",
    "joint_pos",
    "joint_vel",
    "action",
    "heights",
)
"""Observations this controller can provide."""
LARGEST_OBSERVATION = 100.0
"""A scaled observation beyond this is implausible; in training they are of order 1."""
LARGEST_STEP_S = 0.1
"""The safe stance moves by no more than this much time in one step, however late the step comes [s]."""


@dataclass(frozen=True, eq=False)
class JointCommand:
    """What the drives are to do until the next step, with the gains that the policy file names."""

    targets: np.ndarray
    """(joints,) position targets, always finite and within the joints' ranges [rad]."""
    mode: str
    """`target`, `hold`, `joystick`, `stop`, `way_points` or `safe`."""
    reason: str
    """Why the controller does not simply do as told; empty where it does."""


class Controller:
    """Runs an exported policy.

    On an input it must not act on (stale, non-finite, of the wrong size, no goal) it goes to the safe stance: joint
    targets jump to where the joints are, so that only the drives' damping acts, and glide from there to the default
    pose. The policy takes over again once all inputs have been good for `Safety.recover_s`.
    """

    def __init__(self, policy: PolicyFile, safety: Safety = DEFAULT, log: ControlLog | None = None):
        """Prepare everything that does not change.

        Args:
            log: takes down every step, if given.

        Raises:
            ArriveError: the policy needs an observation that this controller cannot provide.
        """
        for term in policy.terms:
            if term.name not in KNOWN_TERMS:
                raise unknown_name("observation of the controller, needed by the policy:", term.name, KNOWN_TERMS)
        self.policy, self.safety, self.log = policy, safety, log
        robot = policy.robot
        self._default = np.array(robot.default_joint_pos_rad)
        self._scale = np.concatenate([np.full(term.stop - term.start, term.scale) for term in policy.terms])
        self._grid = HeightGrid(policy.grid)
        self._limits = Limits(robot)
        self._navigator = Navigator(policy.task)
        self.reset()

    @classmethod
    def load(cls, path: Path | str, safety: Safety = DEFAULT, log: ControlLog | None = None) -> Controller:
        """Read an exported policy.

        Raises:
            ArriveError: see `read_policy_file`.
        """
        return cls(read_policy_file(path), safety, log)

    def reset(self) -> None:
        """Start afresh, as after switching on."""
        self._navigator.reset()
        self._action = np.zeros(len(self._default))
        self._known_pos: np.ndarray | None = None
        self._held: np.ndarray | None = None
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
            try:
                command = self._resume(frame, *self._attempt(frame))
            except BadInput as problem:
                command = self._fall_back(frame, str(problem))
        if np.isfinite(frame.now_s):
            self._last_now_s = frame.now_s
        if self.log is not None:
            self.log.append(self.policy, frame, command)
        return command

    def observe(self, frame: Frame) -> tuple[np.ndarray, Order]:
        """The network's input (observations,) and the command in it.

        Raises:
            BadInput: an input the policy must not act on.
        """
        safety, task = self.safety, self.policy.task
        if self._last_now_s is not None and not frame.now_s >= self._last_now_s:
            raise BadInput("the clock went back or stopped being a number")
        check_sensors(frame, safety, len(self._default))
        check_terrain(frame, safety, len(self._grid.points))
        pos = frame.base_pos_w
        heights, seen = self._grid.fill(frame.heights_w, pos[2] - self.policy.robot.standing_height_m)
        if seen < safety.least_seen:
            raise BadInput(f"only {seen:.0%} of the ground was seen")
        ground = _median(heights)
        quat = frame.base_quat_w / np.linalg.norm(frame.base_quat_w)
        order = self._navigator.order(frame.goal, pos, heading(quat), ground, frame.now_s)
        if seen < 1.0:
            order = order._replace(reason=", ".join(filter(None, (order.reason, f"{seen:.0%} of the ground seen"))))
        to_world, grid = matrix(quat), self.policy.grid
        values = {
            "base_lin_vel": frame.base_lin_vel_b,
            "base_ang_vel": frame.base_ang_vel_b,
            "gravity": -to_world[2],
            "target": (order.target_w - pos) @ to_world,
            "time_left": (min(order.time_left_s, task.episode_s),),
            "joint_pos": frame.joint_pos - self._default,
            "joint_vel": frame.joint_vel,
            "action": self._action,
            "heights": np.minimum(np.maximum(pos[2] - grid.offset_m - heights, -grid.clip_m), grid.clip_m),
        }
        return np.concatenate([values[term.name] for term in self.policy.terms]) * self._scale, order

    def _attempt(self, frame: Frame) -> tuple[Order, np.ndarray]:
        observation, order = self.observe(frame)
        if not np.abs(observation).max() <= LARGEST_OBSERVATION:
            worst = int(np.argmax(~(np.abs(observation) <= LARGEST_OBSERVATION)))
            name = next(term.name for term in self.policy.terms if term.start <= worst < term.stop)
            raise BadInput(f"{name} is implausibly large")
        action = self.policy.act(observation[None].astype(np.float32))[0].astype(np.float64)
        if not np.isfinite(action).all():
            raise BadInput("the network's output is not finite")
        return order, action

    def _resume(self, frame: Frame, order: Order, action: np.ndarray) -> JointCommand:
        """Act, unless a fault was too short a time ago."""
        if self._held is not None:
            self._good_since_s = frame.now_s if self._good_since_s is None else self._good_since_s
            # A microsecond of tolerance, so that rounding of times does not cost a step.
            if frame.now_s - self._good_since_s < self.safety.recover_s - 1e-6:
                return self._safe(frame, "recovering")
            # The action that the policy sees as its last is the one the robot is carrying out.
            self._action = (self._held - self._default) / self.policy.robot.action_scale_rad
            self._held, self._good_since_s = None, None
            order, action = self._attempt(frame)
        self._action, self._known_pos = action, frame.joint_pos
        targets = self._default + self.policy.robot.action_scale_rad * action
        return JointCommand(
            self._limits.within_torque(targets, frame.joint_pos, frame.joint_vel), order.mode, order.reason
        )

    def _fall_back(self, frame: Frame, reason: str) -> JointCommand:
        self._good_since_s = None
        self._navigator.release()
        return self._safe(frame, reason)

    def _safe(self, frame: Frame, reason: str) -> JointCommand:
        """The safe stance, one step further; before any good sensors arrived it is the default pose itself."""
        fresh = self._sensors_good(frame)
        if fresh:
            self._known_pos = frame.joint_pos
        if self._held is None:
            self._held = self._limits.within_joints(self._default if self._known_pos is None else self._known_pos)
        else:
            reach = self.safety.glide_rad_s * self._elapsed_s(frame)
            self._held = self._held + np.clip(self._default - self._held, -reach, reach)
        targets = self._held.copy()
        if fresh:
            targets = self._limits.within_torque(targets, frame.joint_pos, frame.joint_vel)
        return JointCommand(targets, "safe", reason)

    def _sensors_good(self, frame: Frame) -> bool:
        try:
            check_sensors(frame, self.safety, len(self._default))
        except BadInput:
            return False
        return True

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
