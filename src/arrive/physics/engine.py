"""The interface between environment and physics engines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import mujoco
    import torch
    from torch import Tensor

STATE_FIELDS = ("time", "qpos", "qvel", "qacc_warmstart", "ctrl")
"""The parts of MuJoCo's integration state that a robot uses."""


@dataclass(frozen=True)
class Readings:
    """The robots after a policy step. Positions and velocities are current, and the rest is one physics step older.

    All float32 on the engine's device. Quaternions are (w, x, y, z).
    """

    base_pos_w: Tensor
    """(num_envs, 3) [m]."""
    base_quat_w: Tensor
    """(num_envs, 4), rotates from base to world."""
    base_lin_vel_w: Tensor
    """(num_envs, 3) [m/s]."""
    base_ang_vel_b: Tensor
    """(num_envs, 3) [rad/s]."""
    joint_pos: Tensor
    """(num_envs, num_joints) [rad]."""
    joint_vel: Tensor
    """(num_envs, num_joints) [rad/s]."""
    joint_torque: Tensor
    """(num_envs, num_joints) [N m]."""
    foot_vel_w: Tensor
    """(num_envs, num_feet, 3) [m/s]."""
    crash_contacts: Tensor
    """(num_envs,) number of contacts of the crash bodies."""
    collision_contacts: Tensor
    """(num_envs,) number of collision bodies in contact, the paper's N_c."""
    foot_contacts: Tensor
    """(num_envs, num_feet) number of contacts of each foot."""
    finite: Tensor
    """(num_envs,) bool: the simulation did not diverge."""


class Physics(Protocol):
    """Many robots, each in its own small world, which is chosen from a fixed list of compiled worlds."""

    num_envs: int
    device: torch.device
    decimation: int
    """Physics steps per policy step."""

    def set_decimation(self, decimation: int) -> None:
        """Divide the policy step into this many physics steps from now on, see `options.with_decimation`.

        It is not for worlds with `physics.motor=network`: an actuator network has its own step.
        """

    def model_of_env(self, env_id: int) -> mujoco.MjModel:
        """The compiled world an environment is in."""

    def place(self, env_ids: Tensor, world_ids: Tensor) -> None:
        """Move environments to worlds, by index into the list of compiled worlds."""

    def reset(self, env_ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Set robots' states: qpos (n, nq) and qvel (n, nv) in MuJoCo's order [m, rad, m/s, rad/s]."""

    def push(self, env_ids: Tensor, lin_vel_w: Tensor) -> None:
        """Add (n, 3) world-frame velocity to the bases [m/s]."""

    def deactivate(self, env_ids: Tensor) -> None:
        """Stop simulating these environments, because an evaluation does not need them any more."""

    def step(self, joint_targets: Tensor) -> None:
        """Advance one policy step with (num_envs, num_joints) joint targets [rad]."""

    def read(self, env_ids: Tensor | None = None) -> Readings:
        """The current state of all robots, or of (n,) these in this order."""

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that an exact resume needs."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Resume exactly from a `state_dict`."""
