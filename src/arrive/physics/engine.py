"""What an environment asks of a physics engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import torch
    from torch import Tensor

STATE_FIELDS = ("time", "qpos", "qvel", "qacc_warmstart", "ctrl")
"""The parts of MuJoCo's integration state that a robot uses."""


@dataclass(frozen=True)
class Readings:
    """The robots after a policy step; positions and velocities are current, the rest is one physics step older.

    All float32 on the engine's device. Quaternions are (w, x, y, z).
    """

    base_pos_w: Tensor
    """(num_envs, 3) [m]."""
    base_quat_w: Tensor
    """(num_envs, 4), rotates base into world."""
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
    """(num_envs,) contacts of the crash bodies."""
    collision_contacts: Tensor
    """(num_envs,) collision bodies in contact, the paper's N_c."""
    foot_contacts: Tensor
    """(num_envs, num_feet) contacts of each foot."""
    finite: Tensor
    """(num_envs,) whether the simulation's state is finite and it did not diverge."""


class Physics(Protocol):
    """Many robots, each in a small world of its own that is chosen from a fixed list of compiled ones."""

    num_envs: int
    device: torch.device

    def place(self, env_ids: Tensor, world_ids: Tensor) -> None:
        """Move environments to worlds, by index into the list of compiled worlds."""

    def reset(self, env_ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Put robots into states: qpos (n, nq) and qvel (n, nv) in MuJoCo's order [m, rad, m/s, rad/s]."""

    def push(self, env_ids: Tensor, lin_vel_w: Tensor) -> None:
        """Add (n, 3) world-frame velocity to the bases [m/s]."""

    def retire(self, env_ids: Tensor) -> None:
        """Leave environments out of every further step, where an evaluation has seen what it wanted."""

    def step(self, joint_targets: Tensor) -> None:
        """Advance one policy step with (num_envs, num_joints) joint targets [rad]."""

    def read(self, env_ids: Tensor | None = None) -> Readings:
        """The robots as they are now: all, or (n,) these in this order."""

    def state_dict(self) -> dict[str, Tensor]:
        """Everything needed to go on exactly from here."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on exactly from a `state_dict`."""
