"""MuJoCo Warp: all robots in parallel on a GPU, or for tests on Warp's CPU device."""

import dataclasses
import gc
import warnings
from collections.abc import Sequence

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from arrive.actuation.network import ActuatorNetwork
from arrive.errors import ArriveError
from arrive.physics.divergence import MAX_SPEED
from arrive.physics.engine import STATE_FIELDS, Readings
from arrive.physics.options import PhysicsConfig, change_decimation
from arrive.physics.template import build_template, differing_fields, static_geoms
from arrive.physics.warp_contacts import ContactCount, drop_false_contacts
from arrive.physics.warp_motors import WarpMotors
from arrive.physics.world import sensor_layout
from arrive.robots.robot import Robot

ROWS_PER_CONTACT = 4
"""Constraint rows of a contact with sliding friction: four with a pyramidal cone, three with an elliptic one."""
OWN_LOSS = mjw.OverflowType.NEFC | mjw.OverflowType.NJMAX_NNZ | mjw.OverflowType.CCD | mjw.OverflowType.HFIELD
"""Overflows that make one robot lose contacts. Its simulation then counts as diverged."""
SHARED_LOSS = mjw.OverflowType.BROADPHASE | mjw.OverflowType.NARROWPHASE
"""Overflows of the contact list that all robots share. Any robot may lose contacts, so this is an error."""
CHECK_STEPS = 100
"""Policy steps between checks of the shared overflow. Each check waits for the GPU."""


class WarpPhysics:
    """`Physics` with MuJoCo Warp in float32. State, actions and readings stay on the device.

    On a GPU a policy step is one CUDA graph. Sums over contacts have no fixed order there, so runs with the same seed
    agree statistically but not bit for bit.
    """

    def __init__(
        self,
        robot: Robot,
        worlds: Sequence[mujoco.MjModel],
        config: PhysicsConfig,
        num_envs: int,
        device: torch.device,
        network: ActuatorNetwork | None = None,
    ):
        """Put the template and every world's own values on the device, with every environment in the first world.

        Args:
            worlds: models with the same layout, compiled with this `config`.
            device: a CUDA device, or the CPU.
            network: computes the torques of worlds that were compiled with `physics.motor=network`.

        Raises:
            ArriveError: the worlds differ in a field that MuJoCo Warp cannot vary.
        """
        wp.config.log_level = wp.LOG_WARNING  # no banner, no line per kernel
        wp.init()
        self.num_envs, self.device = num_envs, torch.device(device)
        self._worlds, self._config, self.decimation = list(worlds), config, config.decimation
        self._layout = sensor_layout(robot)
        self._warp_device = wp.device_from_torch(self.device)
        template = build_template(robot, worlds, config)
        tables = differing_fields(template, worlds, _batched_fields())
        self._build(robot, template, tables, network)
        self._state = {name: wp.to_torch(getattr(self._data, name)) for name in STATE_FIELDS}
        self._motor_state = self._motors.state() if self._motors else {}
        self._state |= self._motor_state
        self._sensors, self._torque = (wp.to_torch(getattr(self._data, n)) for n in ("sensordata", "actuator_force"))
        self._overflow = wp.to_torch(self._data.overflow)
        self._shared_loss = torch.zeros((), dtype=torch.bool, device=self.device)
        self._bind_worlds(template, tables)
        self._world_of_env = torch.zeros(num_envs, dtype=torch.long, device=self.device)
        self._inactive = torch.zeros(0, dtype=torch.long, device=self.device)
        self._steps = 0
        self.place(torch.arange(num_envs, device=self.device), self._world_of_env.clone())
        self._graph = self._capture()

    def _build(
        self,
        robot: Robot,
        template: mujoco.MjModel,
        tables: dict[str, np.ndarray],
        network: ActuatorNetwork | None,
    ) -> None:
        """Put model and data on the device, with the contact counter and the actuator network."""
        num_envs, config = self.num_envs, self._config
        # MuJoCo Warp never resets a diverged robot and does not know the flag.
        template.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        with wp.ScopedDevice(self._warp_device):
            self._model = mjw.put_model(template, batch_sizes=dict.fromkeys(tables, num_envs))
            self._data = mjw.make_data(
                template,
                nworld=num_envs,
                nconmax=config.max_contacts,
                njmax=template.njnt + ROWS_PER_CONTACT * config.max_contacts,
            )
            self._contacts = ContactCount(robot, template, self._data)
            self._motors = WarpMotors(network, robot.motors, config.motor_clip, self._data) if network else None
        if template.nhfield:
            self._model.callback.contactfilter = drop_false_contacts
        self._model.opt.warn_overflow = 0  # reported below, and not by printing from the device

    def _bind_worlds(self, template: mujoco.MjModel, tables: dict[str, np.ndarray]) -> None:
        """Pair each environment's values on the device with the table from which they are taken.

        Warp computes the world pose of fixed geoms only once, so these poses are set too.
        """
        views = {name: wp.to_torch(getattr(self._model, name)) for name in tables}
        if "geom_pos" in tables:
            fixed = static_geoms(template)
            tables = tables | {
                "geom_xpos": tables["geom_pos"][:, fixed],
                "geom_xmat": _matrices(tables.get("geom_quat", template.geom_quat[None])[:, fixed]),
            }
            views |= {name: wp.to_torch(getattr(self._data, name))[:, fixed] for name in ("geom_xpos", "geom_xmat")}
        self._world_values = []
        for name, table in tables.items():
            view = views[name]
            values = torch.from_numpy(np.ascontiguousarray(table)).to(self.device, view.dtype)
            values = values.reshape(len(table), *view.shape[1:]).expand(len(self._worlds), *view.shape[1:])
            self._world_values.append((view, values))

    def _capture(self) -> wp.Graph | None:
        """The policy step as a CUDA graph; None where there is no CUDA or it has no memory pool."""
        if not self._warp_device.is_cuda:
            return None
        if not self._warp_device.is_mempool_enabled:
            warnings.warn("this GPU has no CUDA memory pool: physics runs without a CUDA graph, slower", stacklevel=2)
            return None
        self._model.opt.graph_conditional = wp.is_conditional_graph_supported()
        saved = self.state_dict()
        wp.synchronize_device(self._warp_device)
        self._advance()  # loads the kernels, which cannot be done while a graph is captured
        wp.synchronize_device(self._warp_device)
        gc.collect()
        gc.disable()  # a graph that is freed meanwhile would be recorded into this one
        try:
            with wp.ScopedCapture(self._warp_device) as capture:
                self._advance()
        finally:
            gc.enable()
        self.load_state_dict(saved)
        return capture.graph

    def _launch(self) -> None:
        """Run the policy step, on a GPU in torch's own stream, so that the two keep their order."""
        if not self._warp_device.is_cuda:
            self._advance()
            return
        stream = wp.stream_from_torch(torch.cuda.current_stream(self.device))
        if self._graph is not None:
            wp.capture_launch(self._graph, stream)
            return
        with wp.ScopedStream(stream):
            self._advance()

    def _advance(self) -> None:
        """The kernels of one policy step."""
        with wp.ScopedDevice(self._warp_device):
            self._data.overflow.zero_()
            for _ in range(self.decimation):
                if self._motors:
                    self._motors.launch()
                mjw.step(self._model, self._data)
            self._contacts.launch()

    def set_decimation(self, decimation: int) -> None:
        if decimation == self.decimation:
            return
        config = change_decimation(self._worlds, self._config, decimation)
        wp.to_torch(self._model.opt.timestep).fill_(config.timestep_s)
        wp.to_torch(self._model.geom_solref)[..., 0] = config.contact_time_s
        self.decimation = decimation
        self._graph = self._capture()

    def model_of_env(self, env_id: int) -> mujoco.MjModel:
        """The compiled world an environment is in."""
        return self._worlds[int(self._world_of_env[env_id])]

    def place(self, env_ids: Tensor, world_ids: Tensor) -> None:
        self._world_of_env[env_ids] = world_ids
        for view, values in self._world_values:
            view[env_ids] = values[world_ids]

    def reset(self, env_ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        self._state["qpos"][env_ids] = qpos.float()
        self._state["qvel"][env_ids] = qvel.float()
        self._state["ctrl"][env_ids] = 0.0 if self._motors else qpos[:, 7:].float()
        for view in self._motor_state.values():
            view[env_ids] = 0.0
        self._state["qacc_warmstart"][env_ids] = 0.0
        self._state["time"][env_ids] = 0.0
        self._overflow[env_ids] = 0

    def push(self, env_ids: Tensor, lin_vel_w: Tensor) -> None:
        self._state["qvel"][env_ids, :3] += lin_vel_w.float()

    def deactivate(self, env_ids: Tensor) -> None:
        self._inactive = torch.cat([self._inactive, env_ids]).unique()

    def step(self, joint_targets: Tensor) -> None:
        """Advance one policy step. Inactive robots are computed with the others, and their state is then restored.

        Raises:
            ArriveError: the shared list of contacts overflowed.
        """
        (self._motors.targets if self._motors else self._state["ctrl"]).copy_(joint_targets)
        kept = {name: view[self._inactive] for name, view in self._state.items()}
        self._launch()
        for name, values in kept.items():
            self._state[name][self._inactive] = values
        self._shared_loss |= (self._overflow & int(SHARED_LOSS)).any()
        self._steps += 1
        if self._steps % CHECK_STEPS == 0:
            self._check_shared_loss()

    def _check_shared_loss(self) -> None:
        if bool(self._shared_loss):
            room = self._data.naconmax // self.num_envs
            raise ArriveError(
                f"the robots had more than {room} contacts on average, and some were lost: "
                f"set physics.max_contacts to {2 * room} or more"
            )

    def read(self, env_ids: Tensor | None = None) -> Readings:
        rows = torch.arange(self.num_envs, device=self.device) if env_ids is None else env_ids
        qpos, qvel, sensors = self._state["qpos"][rows], self._state["qvel"][rows], self._sensors[rows]
        crash, collision, foot = (contacts[rows] for contacts in self._contacts.read())
        own_loss = (self._overflow[rows] & int(OWN_LOSS)) != 0
        return Readings(
            base_pos_w=qpos[:, :3],
            base_quat_w=qpos[:, 3:7],
            base_lin_vel_w=qvel[:, :3],
            base_ang_vel_b=qvel[:, 3:6],
            joint_pos=qpos[:, 7:],
            joint_vel=qvel[:, 6:],
            joint_torque=self._torque[rows],
            foot_vel_w=sensors[:, self._layout.foot_velocity].unflatten(1, (-1, 3)),
            crash_contacts=crash.sum(-1),
            collision_contacts=(collision > 0).float().sum(-1),
            foot_contacts=foot,
            # A NaN compares false, so it fails the bound too.
            finite=(qvel.abs().amax(-1) < MAX_SPEED) & qpos.isfinite().all(-1) & ~own_loss,
        )

    def state_dict(self) -> dict[str, Tensor]:
        self._check_shared_loss()
        state = {name: view.clone() for name, view in self._state.items()}
        return state | {"world_of_env": self._world_of_env.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, view in self._state.items():
            view.copy_(state[name])
        worlds = state["world_of_env"].to(self.device)
        self.place(torch.arange(self.num_envs, device=self.device), worlds)
        self._overflow.zero_()


def _batched_fields() -> set[str]:
    """Names of the model fields that may have one value per robot in MuJoCo Warp."""
    fields = dataclasses.fields(mjw.Model)
    return {field.name for field in fields if getattr(field.type, "shape", (0,))[:1] == ("*",)}


def _matrices(quats: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation matrices of (..., 4) quaternions."""
    flat = np.empty((quats.size // 4, 9))
    for row, quat in zip(flat, quats.reshape(-1, 4), strict=True):
        mujoco.mju_quat2Mat(row, quat)
    return flat.reshape(*quats.shape[:-1], 3, 3)
