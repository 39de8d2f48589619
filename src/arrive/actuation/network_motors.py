"""The motors of all robots by one actuator network."""

from collections.abc import Sequence

import numpy as np

from arrive.actuation.clip import MotorClip, TorqueClip
from arrive.actuation.motor import Motor
from arrive.actuation.network import ActuatorNetwork
from arrive.actuation.runtime import make_runtime

PREFIX = "motor_"
"""Beginning of the names of the motors' state beside that of the simulation."""


class NetworkMotors:
    """A network that gives the torque of every joint at every physics step, cut at what its motor can give."""

    def __init__(self, network: ActuatorNetwork, motors: Sequence[Motor], clip: MotorClip, num_envs: int):
        """Start all joints at rest.

        Args:
            motors: of each joint of a robot, whose limits cut.
        """
        self._clip, self._shape = TorqueClip(motors, clip), (num_envs, len(motors))
        self._runtime = make_runtime(network, num_envs * len(motors))
        self._error, self._speed = np.zeros((2, *self._shape), dtype=np.float32)

    def torque(self, targets: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """Torque for the next physics step.

        Args:
            targets, joint_pos: (num_envs, num_joints) [rad].
            joint_vel: (num_envs, num_joints) [rad/s].

        Returns:
            (num_envs, num_joints) [N m], a view that the next call overwrites.
        """
        np.subtract(targets, joint_pos, out=self._error, casting="same_kind")
        np.copyto(self._speed, joint_vel, casting="same_kind")
        with np.errstate(all="ignore"):  # a diverged robot's NaN stays in its own columns, and the engine reports it
            torque = self._runtime.step(self._error.ravel(), self._speed.ravel()).reshape(self._shape)
            self._clip.cut(torque, self._speed)
        return torque

    def reset(self, env_ids: np.ndarray) -> None:
        """Reset the state of these robots' joints."""
        joints = self._shape[1]
        self._runtime.reset((env_ids[:, None] * joints + np.arange(joints)).ravel())

    def state(self) -> dict[str, np.ndarray]:
        """A copy of everything that is remembered, (num_envs, num_joints, ...) each."""
        state = self._runtime.state()
        return {PREFIX + name: array.reshape(*self._shape, *array.shape[1:]) for name, array in state.items()}

    def load_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on exactly from a `state`, which may have other entries too."""
        mine = {name.removeprefix(PREFIX): array for name, array in state.items() if name.startswith(PREFIX)}
        self._runtime.load_state({name: array.reshape(-1, *array.shape[2:]) for name, array in mine.items()})
