"""Surfaces of robot and ground: colour, gloss, and a texture on the ground that makes motion visible."""

from functools import lru_cache

import numpy as np
from PIL import Image

from arrive.play.colours import Rgb
from arrive.play.gltf import glb
from arrive.play.shapes import Triangles

TEXTURE_M = 2.0
"""The texture repeats after this length [m]."""
PLATES = 4
"""Plates along an edge of the texture, half a metre each."""
PIXELS = 512
"""Pixels along an edge of the texture."""
JOINT_PX = 2
"""Half the width of the joints between plates [px]."""
PLATE_SPREAD, GRAIN, JOINT = 0.06, 0.02, 0.72
"""Spread of brightness between plates and between pixels, and brightness of the joints; 1 is white."""
NARROW_M = 0.45
"""A long face narrower than this is a stair tread: joints along it would look like more stairs [m]."""
SIDE, DARKENING_M = 0.6, 1.2
"""Brightness at the top of an upright face relative to level ground; depth over which it falls to 1/e [m]."""
GROUND_ROUGHNESS, ROBOT_ROUGHNESS = 0.95, 0.42


def robot_surface(mesh: Triangles, colour: Rgb) -> bytes:
    """A glTF file of a smooth, slightly shiny surface."""
    return glb(mesh.vertices, mesh.faces, linear(colour), ROBOT_ROUGHNESS, normals=smooth_normals(mesh))


def ground_surface(mesh: Triangles, colour: Rgb) -> bytes:
    """A glTF file of flat faces with the ground texture in its real size. Upright faces are darker."""
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    texture = (ground_texture(), box_coordinates(vertices) / TEXTURE_M)
    return glb(vertices, faces, linear(colour), GROUND_ROUGHNESS, texture=texture, shades=shades(vertices))


def linear(colour: Rgb) -> tuple[float, float, float]:
    """An sRGB colour, 0 to 255, in linear light, 0 to 1 (IEC 61966-2-1)."""
    share = np.array(colour) / 255.0
    return tuple(np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).tolist())


def smooth_normals(mesh: Triangles) -> np.ndarray:
    """(n, 3) unit normals of vertices: the mean of their faces' normals, weighted by area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.zeros_like(mesh.vertices, dtype=float)
    for corner in mesh.faces.T:
        np.add.at(normals, corner, np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def box_coordinates(vertices: np.ndarray) -> np.ndarray:
    """(n, 2) texture coordinates [m] of the corners (n, 3) of triangles, projected along the axis that they face most.

    Upright faces get no horizontal joints, and narrow faces none along them, so that only edges look like edges.
    """
    corners = vertices.reshape(-1, 3, 3)
    normal = np.abs(_normals(corners))
    # A slope counts as level ground up to 63 degrees.
    normal[:, 2] *= 2.0
    facing = normal.argmax(axis=1)
    axes = np.array([[1, 2], [0, 2], [0, 1]])[facing]
    places = np.take_along_axis(corners, axes[:, None, :].repeat(3, axis=1), axis=2)
    extent = np.ptp(places, axis=1)
    plain = (extent < NARROW_M) & (extent[:, ::-1] > NARROW_M)
    plain[facing != 2, 1] = True
    # The same for both triangles of a rectangle.
    middle = (places.min(axis=1) + places.max(axis=1)) / 2
    middle = (np.floor(middle * PLATES / TEXTURE_M) + 0.5) * TEXTURE_M / PLATES
    return np.where(plain[:, None], middle[:, None], places).reshape(-1, 2)


def shades(vertices: np.ndarray) -> np.ndarray:
    """(n,) brightness of the corners (n, 3) of triangles. Upright faces get darker with depth, as in a hole."""
    corners = vertices.reshape(-1, 3, 3)
    normal = _normals(corners)
    upright = np.abs(normal[:, 2]) < 0.3 * np.linalg.norm(normal, axis=1)
    depth = corners[..., 2].max(axis=1, keepdims=True) - corners[..., 2]
    return np.where(upright[:, None], SIDE * np.exp(-depth / DARKENING_M), 1.0).reshape(-1)


def _normals(corners: np.ndarray) -> np.ndarray:
    """(n, 3) normals of triangles (n, 3, 3); their length is twice the area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@lru_cache(maxsize=1)
def ground_texture() -> Image.Image:
    """Square grey plates of slightly different brightness, with joints between them."""
    rng = np.random.default_rng(7)
    size = PIXELS // PLATES
    plates = 1.0 - PLATE_SPREAD + rng.uniform(-PLATE_SPREAD, PLATE_SPREAD, (PLATES, PLATES))
    brightness = plates.repeat(size, axis=0).repeat(size, axis=1)
    brightness += rng.normal(0.0, GRAIN, brightness.shape)
    place = np.arange(PIXELS) % size
    joint = (place < JOINT_PX) | (place >= size - JOINT_PX)
    brightness[joint] *= JOINT
    brightness[:, joint] *= JOINT
    return Image.fromarray((255 * np.clip(brightness, 0.0, 1.0)).astype(np.uint8))
