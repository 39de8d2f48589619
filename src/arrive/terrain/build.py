"""Builds tiles and checks them, so that no broken tile reaches the training loop."""

import numpy as np

from arrive.errors import ArriveError
from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import DEEP_FLOOR, cell_grid
from arrive.terrain.tile import MAX_GEOMS, START_RADIUS, Tile, cell_index

TARGET_DISTANCE = (1.0, 5.0)
"""Distances for which targets are checked where a task names none [m] (paper, section Episode Process)."""
EVALUATION_TARGET = (5.0, 0.0)
"""Target of the evaluation layout [m] (paper, section Maximum Terrain Difficulty)."""
MIN_VALID_SHARE = 0.25
"""Smallest share of the training targets that must be valid. With fewer, sampling gets slow."""
MIN_CROSSING_SHARE = 0.05
"""Smallest share that must be valid and beyond the terrain. With fewer, too few episodes change the level."""


def build_tile(
    family: Family,
    value: float,
    rng: np.random.Generator,
    layout: Layout,
    size: float = 1.0,
    target_distance: tuple[float, float] = TARGET_DISTANCE,
) -> Tile:
    """Build a tile of the family and check it.

    Args:
        size: size of the robot, see `Robot.size`.
        target_distance: shortest and longest distance of the training targets, uniform between the two [m].

    Raises:
        ArriveError: too many geoms, cells without ground, a start that is not level at height zero, or too few valid
            targets; the message names the family and the value.
    """
    tile = family.build(value, rng, layout, size)
    problem = _ground_problem(tile, size) or _target_problem(tile, layout, target_distance)
    if problem:
        parameter = f"{family.parameter} {value:g} {family.unit}".strip()
        raise ArriveError(f"terrain {family.name!r} with {parameter} ({layout} layout): {problem}")
    return tile


def _ground_problem(tile: Tile, size: float) -> str:
    """What is wrong with the shapes, or an empty string."""
    if tile.num_geoms > MAX_GEOMS:
        return f"it has {tile.num_geoms} geoms; at most {MAX_GEOMS} are allowed"
    if not (tile.heights > DEEP_FLOOR).all():
        return f"{np.count_nonzero(~(tile.heights > DEEP_FLOOR))} cells of the raster have no ground"
    x, y = cell_grid()
    start = tile.heights[np.hypot(x, y) <= START_RADIUS * size]
    if np.abs(start).max() > 1e-6:
        return f"the ground at the start is between {start.min():.3f} and {start.max():.3f} m high instead of 0"
    return ""


def _target_problem(tile: Tile, layout: Layout, distance: tuple[float, float]) -> str:
    """What is wrong with the targets, or an empty string."""
    counting = tile.target_valid & tile.crossing
    if layout == "evaluation":
        i, j = (cell_index(np.array(coordinate)) for coordinate in EVALUATION_TARGET)
        return "" if counting[i, j] else f"the target {EVALUATION_TARGET} is not valid or not beyond the terrain"
    targets = f"of the targets at {distance[0]:g} to {distance[1]:g} m are valid"
    if (share := target_share(tile.target_valid, distance)) < MIN_VALID_SHARE:
        return f"{share:.1%} {targets}; at least {MIN_VALID_SHARE:.0%} must be"
    if (share := target_share(counting, distance)) < MIN_CROSSING_SHARE:
        return f"{share:.1%} {targets} and beyond it; at least {MIN_CROSSING_SHARE:.0%} must be"
    return ""


def target_share(mask: np.ndarray, distance: tuple[float, float]) -> float:
    """Share of the targets, uniform in distance [m] and angle, whose cell is in `mask`."""
    radius = np.linspace(*distance, 41)[:, None]
    angle = np.linspace(0.0, 2 * np.pi, 120, endpoint=False)[None, :]
    return float(mask[cell_index(radius * np.cos(angle)), cell_index(radius * np.sin(angle))].mean())
