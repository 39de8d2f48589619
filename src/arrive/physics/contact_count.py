"""Contacts per body, counted on the device from MuJoCo Warp's list of contacts.

MuJoCo Warp's contact sensors say the same, but sort up to 64 matches per sensor and robot at every physics step.
"""

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from arrive.robots.robot import Robot


@wp.kernel
def _count(
    num_contacts: wp.array[int],
    world_id: wp.array[int],
    geoms: wp.array[wp.vec2i],
    counter_of_geom: wp.array[int],
    counts: wp.array2d[float],
):
    contact = wp.tid()
    if contact < num_contacts[0]:
        for side in range(2):
            counter = counter_of_geom[geoms[contact][side]]
            if counter >= 0:
                wp.atomic_add(counts, world_id[contact], counter, 1.0)


class ContactCount:
    """Contacts of a robot's crash, collision and foot bodies, as MuJoCo's contact sensors count them."""

    def __init__(self, robot: Robot, model: mujoco.MjModel, data: mjw.Data):
        self._groups = (robot.crash_bodies, robot.collision_bodies, robot.foot_bodies)
        self._bodies = list(dict.fromkeys(name for group in self._groups for name in group))
        counter_of_body = np.full(model.nbody, -1, dtype=np.int32)
        for counter, name in enumerate(self._bodies):
            counter_of_body[model.body(name).id] = counter
        self._data = data
        self._counter_of_geom = wp.array(counter_of_body[model.geom_bodyid], dtype=int)
        self._counts = wp.zeros((data.nworld, len(self._bodies)), dtype=float)
        self._view = wp.to_torch(self._counts)
        self._columns = [
            torch.tensor([self._bodies.index(name) for name in group], device=self._view.device)
            for group in self._groups
        ]

    def launch(self) -> None:
        """Count the contacts of the last physics step; may be captured in a CUDA graph."""
        contact = self._data.contact
        self._counts.zero_()
        wp.launch(
            _count,
            dim=self._data.naconmax,
            inputs=[self._data.nacon, contact.worldid, contact.geom, self._counter_of_geom],
            outputs=[self._counts],
        )

    def read(self) -> tuple[Tensor, Tensor, Tensor]:
        """Contacts of each crash, collision and foot body, (num_envs, bodies) each."""
        crash, collision, foot = (self._view[:, columns] for columns in self._columns)
        return crash, collision, foot
