"""MuJoCo's batched simulation on CPU threads."""

from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from torch import Tensor

from arrive.actuation.network_motors import NetworkMotors
from arrive.physics.divergence import MAX_SPEED, silence_mujoco
from arrive.physics.engine import STATE_FIELDS, Readings
from arrive.physics.options import PhysicsConfig, change_decimation
from arrive.physics.world import sensor_layout
from arrive.robots.robot import Robot


class CpuPhysics:
    """`Physics` with `mujoco.batch`. Results are bit-identical at any number of threads."""

    def __init__(
        self,
        robot: Robot,
        worlds: Sequence[mujoco.MjModel],
        config: PhysicsConfig,
        num_envs: int,
        threads: int = 0,
        motors: NetworkMotors | None = None,
    ):
        """Build the batch with every environment in the first world.

        Args:
            worlds: models with the same layout, compiled with this `config`.
            threads: physics threads; 0 takes one per CPU.
            motors: computes the torques of worlds that were compiled with `physics.motor=network`.
        """
        silence_mujoco()
        self.num_envs = num_envs
        self.device = torch.device("cpu")
        self._config, self.decimation = config, config.decimation
        self._motors = motors
        self._worlds = list(worlds)
        self._layout = sensor_layout(robot)
        self._num_feet = len(robot.foot_sites)
        self._batch = Batch(self._worlds[0], num_envs, threads)
        self._state = {name: self._batch.bind(name) for name in STATE_FIELDS}
        self._sensors = self._batch.bind("sensordata")
        self._torque = self._batch.bind("actuator_force")
        self._world_of_env = np.zeros(num_envs, dtype=np.int64)
        self._moved = True
        self._failed = np.zeros(num_envs, dtype=bool)
        self._inactive = np.zeros(num_envs, dtype=bool)

    def model_of_env(self, env_id: int) -> mujoco.MjModel:
        """The compiled world of an environment."""
        return self._worlds[self._world_of_env[env_id]]

    def set_decimation(self, decimation: int) -> None:
        if decimation == self.decimation:
            return
        change_decimation(self._worlds, self._config, decimation)
        self.decimation, self._moved = decimation, True

    def place(self, env_ids: Tensor, world_ids: Tensor) -> None:
        self._world_of_env[env_ids.numpy()] = world_ids.numpy()
        self._moved = True

    def reset(self, env_ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        ids = env_ids.numpy()
        self._state["qpos"][ids] = qpos.numpy()
        self._state["qvel"][ids] = qvel.numpy()
        self._state["ctrl"][ids] = qpos.numpy()[:, 7:] if self._motors is None else 0.0
        self._state["qacc_warmstart"][ids] = 0.0
        self._state["time"][ids] = 0.0
        self._failed[ids] = False
        if self._motors is not None:
            self._motors.reset(ids)

    def push(self, env_ids: Tensor, lin_vel_w: Tensor) -> None:
        self._state["qvel"][env_ids.numpy(), :3] += lin_vel_w.numpy()

    def deactivate(self, env_ids: Tensor) -> None:
        self._inactive[env_ids.numpy()] = True

    def step(self, joint_targets: Tensor) -> None:
        if self._moved:
            self._batch.set_models([self._worlds[world] for world in self._world_of_env])
            self._moved = False
        ids, targets = np.flatnonzero(~self._inactive) if self._inactive.any() else None, joint_targets.numpy()
        if self._motors is None:
            self._advance(ids, targets, self.decimation)
            return
        joint_pos, joint_vel = self._state["qpos"][:, 7:], self._state["qvel"][:, 6:]
        for _ in range(self.decimation):
            self._advance(ids, self._motors.torque(targets, joint_pos, joint_vel), 1)

    def _advance(self, ids: np.ndarray | None, ctrl: np.ndarray, steps: int) -> None:
        """Make some physics steps with the same (num_envs, joints) targets or torques."""
        self._state["ctrl"][:] = ctrl
        try:
            self._batch.step(ids, nstep=steps)
        except SimulationError as error:
            self._failed[error.ids] = True

    def read(self, env_ids: Tensor | None = None) -> Readings:
        rows = slice(None) if env_ids is None else env_ids.numpy()
        qpos, qvel = _float32(self._state["qpos"][rows]), _float32(self._state["qvel"][rows])
        sensors = _float32(self._sensors[rows])
        layout = self._layout
        speed = qvel.abs().amax(-1)
        return Readings(
            base_pos_w=qpos[:, :3],
            base_quat_w=qpos[:, 3:7],
            base_lin_vel_w=qvel[:, :3],
            base_ang_vel_b=qvel[:, 3:6],
            joint_pos=qpos[:, 7:],
            joint_vel=qvel[:, 6:],
            joint_torque=_float32(self._torque[rows]),
            foot_vel_w=sensors[:, layout.foot_velocity].unflatten(1, (self._num_feet, 3)),
            crash_contacts=sensors[:, layout.crash_contacts].sum(-1),
            collision_contacts=(sensors[:, layout.collision_contacts] > 0).float().sum(-1),
            foot_contacts=sensors[:, layout.foot_contacts],
            # NaN fails the bound too, because comparisons with NaN are false.
            finite=(speed < MAX_SPEED) & qpos.isfinite().all(-1) & ~torch.from_numpy(self._failed[rows].copy()),
        )

    def state_dict(self) -> dict[str, Tensor]:
        state = {name: torch.from_numpy(view.copy()) for name, view in self._state.items()}
        if self._motors is not None:
            state |= {name: torch.from_numpy(array) for name, array in self._motors.state().items()}
        return state | {"world_of_env": torch.from_numpy(self._world_of_env.copy())}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, view in self._state.items():
            view[:] = state[name].numpy()
        if self._motors is not None:
            self._motors.load_state({name: tensor.numpy() for name, tensor in state.items()})
        self._world_of_env[:] = state["world_of_env"].numpy()
        self._moved = True


def _float32(array: np.ndarray) -> Tensor:
    """A float32 copy as a tensor."""
    return torch.from_numpy(array.astype(np.float32))
