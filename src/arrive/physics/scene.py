"""A tile's shapes as MuJoCo geoms."""

import mujoco
import numpy as np

from arrive.errors import ArriveError
from arrive.terrain.tile import HeightField, Tile

GREY = (0.62, 0.62, 0.60)
PARKED_Z = -100.0
"""Height of unused geoms [m]."""
FIELD_NAME = "terrain"
PAVING = "paving"
PLATE_M = 0.5
"""Edge of the ground plates that make motion visible in pictures [m]."""
FIELD_BASE = 1.0
"""Thickness of a height field below its lowest point [m]."""


def add_tile(spec: mujoco.MjSpec, tile: Tile, places: int | None = None) -> None:
    """Add a tile to the world body as geoms called terrain_0, terrain_1, ...

    Boxes come first, and a height field takes the last place. Terrain geoms collide only with geoms whose contype has
    bit 0, and are in group 0.

    Args:
        places: number of geoms, at least the tile's own and by default just those. Unused ones are placed far below.
            All models of a batch need the same number; each one costs time at every physics step.

    Raises:
        ArriveError: the tile has too many shapes.
    """
    places = tile.num_geoms if places is None else places
    if tile.num_geoms > places:
        raise ArriveError(f"a tile has {tile.num_geoms} shapes, but only {places} fit")
    for k in range(places - (tile.height_field is not None)):
        geom = _add_geom(spec, tile, k)
        geom.type = mujoco.mjtGeom.mjGEOM_BOX
        if k < len(tile.boxes):
            box = tile.boxes[k]
            geom.pos, geom.size, geom.quat = box.center, box.half_size, box.quat
        else:
            geom.pos, geom.size = (0.0, 0.0, PARKED_Z), (0.01, 0.01, 0.01)
    if tile.height_field is not None:
        _add_height_field(spec, tile, tile.height_field, places - 1)


def pave(spec: mujoco.MjSpec) -> None:
    """Draw plates with joints on the ground, for pictures. The colours stay."""
    spec.add_texture(
        name=PAVING,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=(1.0, 1.0, 1.0),
        rgb2=(1.0, 1.0, 1.0),
        markrgb=(0.72, 0.72, 0.72),
        width=128,
        height=128,
    )
    material = spec.add_material(name=PAVING, texuniform=True, texrepeat=(1.0 / PLATE_M, 1.0 / PLATE_M))
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = PAVING
    for geom in spec.worldbody.geoms:
        geom.material = PAVING


def _add_geom(spec: mujoco.MjSpec, tile: Tile, place: int, colour: int | None = None) -> mujoco.MjsGeom:
    """Add a terrain geom without a shape, in the palette's colour of that index (default: its place)."""
    index = place if colour is None else colour
    rgb = tile.palette[index] if index < len(tile.palette) else GREY
    return spec.worldbody.add_geom(
        name=f"terrain_{place}", contype=0, conaffinity=1, condim=3, group=0, rgba=(*rgb, 1.0)
    )


def _add_height_field(spec: mujoco.MjSpec, tile: Tile, field: HeightField, place: int) -> None:
    """Add the height field in the palette's colour after the boxes.

    MuJoCo scales the data to 0..1 and multiplies it by `size[2]`. Its rows run along y.
    """
    lowest = float(field.heights.min())
    spread = float(np.ptp(field.heights))
    count_x, count_y = field.heights.shape
    spec.add_hfield(
        name=FIELD_NAME,
        size=(field.half_extent, field.half_extent, max(spread, 1e-3), FIELD_BASE),
        nrow=count_y,
        ncol=count_x,
        userdata=field.heights.T.ravel(),
    )
    geom = _add_geom(spec, tile, place, colour=len(tile.boxes))
    geom.type = mujoco.mjtGeom.mjGEOM_HFIELD
    geom.hfieldname = FIELD_NAME
    geom.pos = (0.0, 0.0, lowest)
