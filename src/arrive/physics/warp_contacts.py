"""What MuJoCo Warp's list of contacts needs: a check of those with height fields, and a count per body."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from arrive.robots.robot import Robot

SURFACE_TOLERANCE = wp.constant(1e-3)
"""A contact this far off the surface of its height field is false [m]."""


@wp.func
def _field_height(x: float, y: float, size: wp.vec4, num_rows: int, num_cols: int, start: int, data: wp.array[float]):
    """Height of a field's triangles above its lowest point [m], x and y from its centre.

    Each square is cut along the diagonal from its low-x, low-y to its high-x, high-y corner.
    """
    u = wp.clamp((x + size[0]) / (2.0 * size[0]), 0.0, 1.0) * float(num_cols - 1)
    v = wp.clamp((y + size[1]) / (2.0 * size[1]), 0.0, 1.0) * float(num_rows - 1)
    i, j = wp.min(int(u), num_cols - 2), wp.min(int(v), num_rows - 2)
    u -= float(i)
    v -= float(j)
    corner = start + j * num_cols + i
    low, high = data[corner], data[corner + num_cols + 1]
    x_first, y_first = data[corner + 1], data[corner + num_cols]
    if u >= v:
        return size[2] * (low + u * (x_first - low) + v * (high - x_first))
    return size[2] * (low + v * (y_first - low) + u * (high - y_first))


@wp.kernel
def _drop_false_contacts(
    num_contacts: wp.array[int],
    world_id: wp.array[int],
    geoms: wp.array[wp.vec2i],
    pos: wp.array[wp.vec3],
    frame: wp.array[wp.mat33],
    geom_type: wp.array[int],
    geom_xpos: wp.array2d[wp.vec3],
    geom_dataid: wp.array2d[int],
    field_size: wp.array[wp.vec4],
    field_rows: wp.array[int],
    field_cols: wp.array[int],
    field_start: wp.array[int],
    field_data: wp.array[float],
    dist: wp.array[float],
):
    contact = wp.tid()
    if contact >= num_contacts[0]:
        return
    geom, world = geoms[contact][0], world_id[contact]
    if geom_type[geom] != wp.static(int(mujoco.mjtGeom.mjGEOM_HFIELD)):
        return
    normal = wp.vec3(frame[contact][0, 0], frame[contact][0, 1], frame[contact][0, 2])
    on_field = pos[contact] - 0.5 * dist[contact] * normal - geom_xpos[world, geom]
    field = geom_dataid[world % geom_dataid.shape[0], geom]
    height = _field_height(
        on_field[0],
        on_field[1],
        field_size[field],
        field_rows[field],
        field_cols[field],
        field_start[field],
        field_data,
    )
    if wp.abs(height - on_field[2]) > SURFACE_TOLERANCE:
        dist[contact] = 1.0


def drop_false_contacts(model: mjw.Model, data: mjw.Data) -> None:
    """Make inactive the contacts whose point on the height field does not lie on its surface; a contact filter.

    MuJoCo Warp 4.0.0 intersects spheres and capsules with the prisms under a field's triangles in float32. Where one
    is near an edge it sometimes finds them centimetres deep although they do not touch, and throws the robot.
    """
    contact = data.contact
    wp.launch(
        _drop_false_contacts,
        dim=data.naconmax,
        inputs=[
            data.nacon,
            contact.worldid,
            contact.geom,
            contact.pos,
            contact.frame,
            model.geom_type,
            data.geom_xpos,
            model.geom_dataid,
            model.hfield_size,
            model.hfield_nrow,
            model.hfield_ncol,
            model.hfield_adr,
            model.hfield_data,
        ],
        outputs=[contact.dist],
    )


@wp.kernel
def _count(
    num_contacts: wp.array[int],
    world_id: wp.array[int],
    geoms: wp.array[wp.vec2i],
    dist: wp.array[float],
    counter_of_geom: wp.array[int],
    counts: wp.array2d[float],
):
    contact = wp.tid()
    if contact < num_contacts[0] and dist[contact] < 0.0:
        for side in range(2):
            counter = counter_of_geom[geoms[contact][side]]
            if counter >= 0:
                wp.atomic_add(counts, world_id[contact], counter, 1.0)


class ContactCount:
    """Contacts of a robot's crash, collision and foot bodies, as MuJoCo's contact sensors count them.

    MuJoCo Warp's contact sensors say the same, but sort up to 64 matches per sensor and robot at every physics step.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel, data: mjw.Data):
        """Count for the robots in `data`, on the present Warp device."""
        groups = (robot.crash_bodies, robot.collision_bodies, robot.foot_bodies)
        bodies = list(dict.fromkeys(name for group in groups for name in group))
        counter_of_body = np.full(model.nbody, -1, dtype=np.int32)
        for counter, name in enumerate(bodies):
            counter_of_body[model.body(name).id] = counter
        self._data = data
        self._counter_of_geom: wp.array[int] = wp.array(counter_of_body[model.geom_bodyid], dtype=int)
        self._counts = wp.zeros((data.nworld, len(bodies)), dtype=float)
        self._view = wp.to_torch(self._counts)
        self._columns = [
            torch.tensor([bodies.index(name) for name in group], device=self._view.device) for group in groups
        ]

    def launch(self) -> None:
        """Count the contacts of the last physics step; may be captured in a CUDA graph."""
        contact = self._data.contact
        self._counts.zero_()
        wp.launch(
            _count,
            dim=self._data.naconmax,
            inputs=[self._data.nacon, contact.worldid, contact.geom, contact.dist, self._counter_of_geom],
            outputs=[self._counts],
        )

    def read(self) -> tuple[Tensor, Tensor, Tensor]:
        """Contacts of each crash, collision and foot body, (num_envs, bodies) each."""
        crash, collision, foot = (self._view[:, columns] for columns in self._columns)
        return crash, collision, foot
