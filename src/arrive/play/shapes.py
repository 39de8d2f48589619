"""Converts MuJoCo's geoms to triangles."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

SEGMENTS = 28
"""Number of sides of round shapes."""
ARC = 7
"""Number of rings per quarter circle."""
Geom = mujoco.mjtGeom
Ring = tuple[float, float]
"""Radius and height along z."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface. Faces share vertices only where it is smooth, so that edges stay sharp."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    faces: np.ndarray
    """(m, 3) indices of vertices, counter-clockwise seen from outside."""

    def placed(self, position: np.ndarray, rotation: np.ndarray) -> "Triangles":
        """The surface rotated by the matrix `rotation` (3, 3), then moved by `position` (3,)."""
        return Triangles(self.vertices @ rotation.T + position, self.faces)


def joined(parts: Sequence[Triangles]) -> Triangles:
    """Several surfaces as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return Triangles(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def geom_triangles(model: mujoco.MjModel, geom: int) -> Triangles:
    """The surface of a geom in its own frame.

    Raises:
        ValueError: the shape is not supported.
    """
    kind, size = Geom(model.geom_type[geom]), model.geom_size[geom]
    if kind == Geom.mjGEOM_BOX:
        return box(size)
    if kind == Geom.mjGEOM_CYLINDER:
        return cylinder(size[0], size[1])
    if kind == Geom.mjGEOM_CAPSULE:
        return capsule(size[0], size[1])
    if kind in (Geom.mjGEOM_SPHERE, Geom.mjGEOM_ELLIPSOID):
        unit = capsule(1.0, 0.0)
        half = size if kind == Geom.mjGEOM_ELLIPSOID else np.full(3, size[0])
        return Triangles(unit.vertices * half, unit.faces)
    if kind == Geom.mjGEOM_MESH:
        return mesh_of(model, int(model.geom_dataid[geom]))
    if kind == Geom.mjGEOM_HFIELD:
        return height_field(model, int(model.geom_dataid[geom]))
    raise ValueError(f"cannot draw a geom of type {kind.name}")


def box(half: Sequence[float] | np.ndarray) -> Triangles:
    """A box around the origin with these half extents [m]."""
    sides = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            corners = sign * np.eye(3)[axis] + np.array([-u - v, u - v, u + v, v - u])
            sides.append(Triangles(corners * half, _quad(0, 1, 2, 3, sign > 0)))
    return joined(sides)


def cylinder(radius: float, half_length: float) -> Triangles:
    """A cylinder along z around the origin [m]."""
    low, high = (radius, -half_length), (radius, half_length)
    return joined([revolved([(0.0, -half_length), low]), revolved([low, high]), revolved([high, (0.0, half_length)])])


def capsule(radius: float, half_length: float) -> Triangles:
    """A capsule along z around the origin, with a straight part of 2 `half_length` [m]; 0 gives a sphere."""
    angle = np.linspace(0.0, np.pi / 2, ARC)
    upper = [(radius * np.cos(a), half_length + radius * np.sin(a)) for a in angle]
    return revolved([(r, -z) for r, z in reversed(upper)] + upper)


def revolved(profile: Sequence[Ring]) -> Triangles:
    """The smooth surface of revolution about z. A profile's points go upwards on its outer side."""
    around = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    rings = [np.stack([r * np.cos(around), r * np.sin(around), np.full(SEGMENTS, z)], axis=1) for r, z in profile]
    here = np.arange(SEGMENTS)
    after = (here + 1) % SEGMENTS
    faces = []
    for k in range(len(profile) - 1):
        a, b, c, d = (k * SEGMENTS + here, k * SEGMENTS + after, (k + 1) * SEGMENTS + after, (k + 1) * SEGMENTS + here)
        faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return Triangles(np.concatenate(rings), np.concatenate(faces))


def mesh_of(model: mujoco.MjModel, mesh: int) -> Triangles:
    """A mesh in its geom's frame [m]."""
    vertices = slice(int(model.mesh_vertadr[mesh]), int(model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh]))
    faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
    return Triangles(np.array(model.mesh_vert[vertices], dtype=float), np.array(model.mesh_face[faces]))


def height_field(model: mujoco.MjModel, field: int) -> Triangles:
    """The upper side of a height field in its geom's frame [m], with the same diagonals as in MuJoCo."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    half_x, half_y, height, _ = model.hfield_size[field]
    start = int(model.hfield_adr[field])
    z = model.hfield_data[start : start + rows * columns].reshape(rows, columns) * height
    y, x = np.meshgrid(np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij")
    index = np.arange(rows * columns).reshape(rows, columns)
    low, x_next, high, y_next = (
        part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    )
    faces = np.concatenate([np.stack([low, x_next, high], axis=1), np.stack([low, high, y_next], axis=1)])
    return Triangles(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces)


def _quad(a: int, b: int, c: int, d: int, forward: bool) -> np.ndarray:
    return np.array([[a, b, c], [a, c, d]] if forward else [[a, c, b], [a, d, c]])
