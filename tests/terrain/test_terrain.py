"""Terrain: rays and contacts agree with the raster, and the shapes with the parameter."""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise, product

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from arrive.build import build_env
from arrive.errors import ArriveError
from arrive.physics.scene import PARKED_Z, add_tile
from arrive.presets import get_preset
from arrive.recipe import make_config
from arrive.terrain import FAMILIES, build_tile, get_family, parse_families
from arrive.terrain.build import target_share
from arrive.terrain.obstacles import CLEAR_RADIUS, HEIGHT, PASSAGE
from arrive.terrain.rasterise import assemble, dilate
from arrive.terrain.shapes import EVALUATION_START, GROUND_HALF, evaluation_span, square
from arrive.terrain.stairs import TREAD
from arrive.terrain.tile import MAX_GEOMS, RASTER_CELL, RASTER_SIZE, Box, Tile, cell_centers, cell_index

LAYOUTS = ("training", "evaluation")
LEVELS = (0, 4, 9)
CASES = list(product(FAMILIES, LAYOUTS, LEVELS))
BALL_RADIUS = 0.1


def tile_at(name: str, layout: str, level: int, seed: int = 0) -> Tile:
    family = FAMILIES[name]
    return build_tile(family, family.value(level, 10), np.random.default_rng(seed), layout)


@lru_cache
def model_of(name: str, layout: str, level: int) -> tuple[Tile, mujoco.MjModel]:
    """A tile and its model, with a ball above the origin."""
    tile = tile_at(name, layout, level)
    return tile, model_with_ball(tile)


def model_with_ball(tile: Tile) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    add_tile(spec, tile, MAX_GEOMS)
    ball = spec.worldbody.add_body(name="ball", pos=(0, 0, 2 * BALL_RADIUS))
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(BALL_RADIUS, 0, 0), mass=1.0, contype=1, conaffinity=0)
    return spec.compile()


def ray_heights(model: mujoco.MjModel, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the terrain that vertical rays from 20 m find."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ball, geom_id = model.body("ball").id, np.array([-1], dtype=np.int32)
    down = np.array([0.0, 0.0, -1.0])
    distances = [
        mujoco.mj_ray(model, data, np.array([*point, 20.0]), down, None, 1, ball, geom_id)
        for point in zip(x, y, strict=True)
    ]
    assert min(distances) >= 0, "a ray hit nothing"
    return 20.0 - np.array(distances)


def near_vertical_wall(tile: Tile, x: float, y: float, margin: float = 1e-3) -> bool:
    """Whether a point lies within `margin` of the plane of an upright box's side."""
    upright = [box for box in tile.boxes if box.quat == (1.0, 0.0, 0.0, 0.0)]
    point = np.array([x, y])
    return any(
        (np.abs(np.abs(point - np.array(box.center[:2])) - np.array(box.half_size[:2])) < margin).any()
        for box in upright
    )


@pytest.mark.parametrize(("name", "layout", "level"), CASES)
def test_rays_find_the_heights_of_the_raster(name, layout, level):
    tile, model = model_of(name, layout, level)
    cells = np.random.default_rng(level).integers(0, RASTER_SIZE, (200, 2))
    points = cell_centers()[cells]
    keep = np.array([not near_vertical_wall(tile, *point) for point in points])
    assert keep.mean() > 0.95
    found = ray_heights(model, *points[keep].T)
    expected = tile.heights[tuple(cells[keep].T)]
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("places", [None, MAX_GEOMS])
def test_a_tile_takes_the_places_it_is_given_and_parks_those_it_does_not_need(places):
    for name, layout, level in CASES:
        tile, spec = tile_at(name, layout, level), mujoco.MjSpec()
        add_tile(spec, tile, places)
        model = spec.compile()
        assert model.ngeom == (tile.num_geoms if places is None else places)
        assert np.count_nonzero(model.geom_pos[:, 2] > PARKED_Z) == tile.num_geoms


def test_a_tile_with_more_shapes_than_places_is_refused():
    tile = tile_at("gap", "training", 0)
    with pytest.raises(ArriveError, match=f"a tile has {tile.num_geoms} shapes, but only {tile.num_geoms - 1} fit"):
        add_tile(mujoco.MjSpec(), tile, tile.num_geoms - 1)


def test_batch_accepts_all_models_and_a_ball_rests_on_the_start_of_each():
    models = [model_of(*case)[1] for case in CASES]
    batch = Batch(models[0], nsim=len(models), nthread=1)
    batch.set_models(models)
    batch.reset()
    qpos = batch.bind("qpos")
    for _ in range(300):
        batch.step()
    assert not batch.status.any()
    np.testing.assert_allclose(qpos[:, 2], BALL_RADIUS, atol=3e-3)
    np.testing.assert_allclose(qpos[:, :2], 0.0, atol=1e-3)


def test_a_ball_rests_where_the_raster_says_on_a_rough_surface():
    """The triangles that collide are those that rays find: a small ball touches the raster's surface."""
    tile, model = model_of("rough", "training", 9)
    data = mujoco.MjData(model)
    cells = np.random.default_rng(1).integers(60, 220, (40, 2))
    for i, j in cells:
        x, y = cell_centers()[i], cell_centers()[j]
        data.qpos[:3] = x, y, tile.heights[i, j] + BALL_RADIUS / 2
        mujoco.mj_forward(model, data)
        assert data.ncon > 0
        data.qpos[2] = tile.heights[i, j] + 2 * BALL_RADIUS
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


def test_rotated_boxes_are_rasterised_exactly():
    rng = np.random.default_rng(3)
    quats = rng.normal(size=(12, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    boxes = [Box(tuple(rng.uniform(-4, 4, 3)), tuple(rng.uniform(0.3, 2.5, 3)), tuple(quat.tolist())) for quat in quats]
    tile = assemble([square(GROUND_HALF, -3.0), *boxes])
    cells = rng.integers(0, RASTER_SIZE, (2000, 2))
    found = ray_heights(model_with_ball(tile), *cell_centers()[cells].T)
    np.testing.assert_allclose(found, tile.heights[tuple(cells.T)], atol=1e-4)


def profile(tile: Tile, x: np.ndarray) -> np.ndarray:
    """Raster heights along +x at y = 0."""
    return tile.heights[cell_index(x), cell_index(np.zeros(1))]


@pytest.mark.parametrize(("layout", "level"), list(product(LAYOUTS, LEVELS)))
class TestParameterIsPhysical:
    def test_gap_is_as_wide_and_no_target_is_in_it(self, layout, level):
        tile = tile_at("gap", layout, level or 1)  # the first one is narrower than a cell of the raster
        low = profile(tile, cell_centers()[cell_centers() > 0]).ravel() < -0.02
        edges = np.flatnonzero(np.diff(low.astype(int))).reshape(-1, 2)
        width = FAMILIES["gap"].value(level or 1, 10)
        np.testing.assert_allclose(np.diff(edges)[:, 0] * RASTER_CELL, width, atol=RASTER_CELL + 1e-6)
        assert len(edges) == (2 if layout == "training" and width < 0.65 else 1)
        assert not tile.target_valid[tile.heights < -0.02].any()
        assert not tile.crossing[tile.heights < -0.02].any()
        depth = min(2.0, 0.03 + 4.0 * (width - 0.02)) if layout == "training" else 2.0
        assert tile.heights.min() == pytest.approx(-depth)
        assert tile.fall_height < 0.0

    def test_pit_is_as_deep(self, layout, level):
        tile = tile_at("pit", layout, level)
        depth = tile.heights[tile.crossing].min() - tile.heights[~tile.crossing].max()
        assert depth == pytest.approx(FAMILIES["pit"].value(level, 10), abs=1e-6)

    @pytest.mark.parametrize(("name", "sign"), [("stairs", 1), ("stairs_down", -1)])
    def test_stairs_rise_by_as_much_at_every_tread(self, layout, level, name, sign):
        first = 1.0 if layout == "training" else EVALUATION_START
        treads = first + (np.arange(12) + 0.5) * TREAD
        heights = profile(tile_at(name, layout, level), treads)
        np.testing.assert_allclose(heights[0], sign * FAMILIES[name].value(level, 10), atol=1e-5)
        np.testing.assert_allclose(np.diff(heights), sign * FAMILIES[name].value(level, 10), atol=1e-5)

    @pytest.mark.parametrize(("name", "sign"), [("slope", 1), ("slope_down", -1)])
    def test_slope_has_the_angle(self, layout, level, name, sign):
        tile = tile_at(name, layout, level)
        rise = profile(tile, np.array([4.025])) - profile(tile, np.array([2.025]))
        angle = np.degrees(np.arctan(rise / 2.0))
        np.testing.assert_allclose(angle, sign * FAMILIES[name].value(level, 10), atol=1e-3)

    def test_steps_have_the_height(self, layout, level):
        value = FAMILIES["steps"].value(level, 10)
        heights = np.unique(tile_at("steps", layout, level).heights)
        np.testing.assert_allclose(heights, value * np.array([-1, -0.5, 0, 0.5, 1]), atol=1e-6)

    def test_rough_stays_within_its_amplitude_and_reaches_most_of_it(self, layout, level):
        value = FAMILIES["rough"].value(level, 10)
        extreme = np.abs(tile_at("rough", layout, level).heights).max()
        assert 0.8 * value <= extreme <= value + 1e-6

    def test_obstacles_have_the_side_and_leave_passages(self, layout, level):
        value = FAMILIES["obstacles"].value(level, 10)
        _, *pillars = tile_at("obstacles", layout, level).boxes
        centers = np.array([pillar.center[:2] for pillar in pillars])
        halves = np.array([pillar.half_size[:2] for pillar in pillars])
        if layout == "evaluation":
            np.testing.assert_allclose(2 * halves, value)
        else:
            assert 0.2 - 1e-9 <= 2 * halves.min() <= 2 * halves.max() <= value + 1e-9
        offsets = np.abs(centers[:, None] - centers[None]) - halves[:, None] - halves[None]
        between = np.linalg.norm(np.maximum(offsets, 0), axis=-1) + np.where(np.eye(len(pillars)), np.inf, 0)
        assert between.min() >= PASSAGE
        assert np.linalg.norm(np.maximum(np.abs(centers) - halves, 0), axis=-1).min() >= CLEAR_RADIUS


@pytest.mark.parametrize("level", [1, 2, 5, 29])
def test_pillars_are_walked_around_from_the_second_level_on(level):
    """Heights that a robot can climb would teach it to climb what it must later avoid."""
    family = FAMILIES["obstacles"]
    tile = build_tile(
        family, family.value(level, get_preset("robust").terrain.levels), np.random.default_rng(0), "training"
    )
    assert tile.heights.max() == pytest.approx(HEIGHT)


def test_evaluation_terrain_cannot_be_bypassed():
    """Along every line in +x, 4 m of stairs, slope or rough ground, the gap or the pit's wall lie in the way."""
    for name in set(FAMILIES) - {"flat", "obstacles", "steps"}:
        heights = tile_at(name, "evaluation", 9).heights
        ahead = heights[cell_index(np.array(EVALUATION_START)) + 1 : cell_index(np.array(evaluation_span(1.0)[1]))]
        assert (np.ptp(ahead, axis=0) > 0.05).all(), name


@pytest.mark.parametrize("level", LEVELS)
def test_obstacles_are_crossed_if_the_straight_way_is_blocked(level):
    """A robot 0.6 m wide that walks straight to the target touches a pillar, on every way that counts and no other."""
    tile = tile_at("obstacles", "training", level)
    rng = np.random.default_rng(0)
    radius, angle = rng.uniform(1.0, 5.0, 2000), rng.uniform(-np.pi, np.pi, 2000)
    targets = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    ways = targets[:, None] * np.linspace(0.0, 1.0, 400)[:, None]
    apart = np.full(len(targets), np.inf)
    for pillar in tile.boxes[1:]:
        outside = np.maximum(np.abs(ways - pillar.center[:2]) - pillar.half_size[:2], 0.0)
        apart = np.minimum(apart, outside.max(-1).min(-1))
    crossing = tile.crossing[cell_index(targets[:, 0]), cell_index(targets[:, 1])]
    assert crossing[apart < 0.22].all()
    assert not crossing[apart > 0.38].any()
    assert 0.1 < crossing[tile.target_valid[cell_index(targets[:, 0]), cell_index(targets[:, 1])]].mean() < 0.9


def test_an_obstacle_blocks_the_straight_way_to_the_evaluation_target():
    for level, seed in product(LEVELS, range(10)):
        tile = tile_at("obstacles", "evaluation", level, seed)
        assert profile(tile, np.arange(0.0, 5.0, RASTER_CELL)).max() > 1.0


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", [name for name in FAMILIES if FAMILIES[name].random])
def test_many_seeds_build(name, layout):
    for seed in range(8):
        for level in (0, 9):
            tile_at(name, layout, level, seed)


@pytest.mark.parametrize(("name", "layout"), list(product(FAMILIES, LAYOUTS)))
def test_the_same_seed_builds_the_same_tile_and_another_seed_only_if_random(name, layout):
    first, again, other = (tile_at(name, layout, 5, seed) for seed in (7, 7, 8))
    assert first.boxes == again.boxes
    np.testing.assert_array_equal(first.heights, again.heights)
    np.testing.assert_array_equal(first.target_valid, again.target_valid)
    assert np.array_equal(first.heights, other.heights) is not FAMILIES[name].random


def longest_run(flags: np.ndarray) -> int:
    """How many flags in a row are set at most."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int((ends[1::2] - ends[::2]).max(initial=0))


def hardness(tile: Tile) -> dict[str, float]:
    """What makes training ground hard: what robots must step over, up or around."""
    heights, crossing = tile.heights, tile.crossing
    steps = max(np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1))
    return {
        "largest step": float(steps),
        "deepest": float(-heights.min()),
        "highest": float(heights.max()),
        "hole": float((heights < -0.02).mean()) if tile.fall_height > -np.inf else 0.0,
        "widest hole": float(longest_run(profile(tile, cell_centers()).ravel() < -0.02)),
        "boxes": float(len(tile.boxes)) if not tile.separates else 0.0,
        "roughness": float(heights[crossing].std()),
    }


@pytest.mark.parametrize("name", sorted(set(FAMILIES) - {"flat"}))
def test_every_level_is_harder_than_the_one_before(name):
    """Something grows by every level, and nothing that makes it hard shrinks by more than chance."""
    family = FAMILIES[name]
    mean = []
    for level in range(20):
        value = family.value(level, 20)
        seeds = range(8 if family.random else 1)
        rows = [hardness(build_tile(family, value, np.random.default_rng(seed), "training")) for seed in seeds]
        mean.append({key: np.mean([row[key] for row in rows]) for key in rows[0]})
    for before, after in pairwise(mean):
        grown = [key for key in before if after[key] > before[key] + 1e-3]
        assert grown, (before, after)
    for key in ("largest step", "deepest"):
        series = [row[key] for row in mean]
        assert all(b > a - 0.02 * abs(a) - 1e-3 for a, b in pairwise(series)), (key, series)


@pytest.mark.parametrize("name", FAMILIES)
def test_the_first_level_is_nearly_flat(name):
    """Nothing on the way is higher or deeper than 3 cm: less than a foot is lifted on flat ground."""
    family = FAMILIES[name]
    tile = build_tile(family, family.lowest, np.random.default_rng(0), "training")
    assert hardness(tile)["largest step"] <= 0.03 + 1e-6


def test_levels_run_from_lowest_to_highest_and_no_further():
    for family in FAMILIES.values():
        assert (family.value(0, 10), family.value(9, 10)) == pytest.approx((family.lowest, family.highest))
        for level in (-1, 10):
            with pytest.raises(ArriveError, match=f"level {level} of {family.name}"):
                family.value(level, 10)


def tile_without_targets(value, rng, layout, size):
    nowhere = np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool)
    return assemble([square(GROUND_HALF, 0.0)], target_valid=nowhere)


BROKEN = {
    "valid": tile_without_targets,
    "no ground": lambda value, rng, layout, size: assemble([square(2.0, 0.0)]),
    "ground at the start": lambda value, rng, layout, size: assemble([square(GROUND_HALF, 0.3)]),
    "65 geoms": lambda value, rng, layout, size: assemble([square(GROUND_HALF, 0.0)] * (MAX_GEOMS + 1)),
}


@pytest.mark.parametrize(("problem", "layout"), list(product(BROKEN, LAYOUTS)))
def test_a_broken_family_fails_when_a_tile_is_built(problem, layout):
    family = replace(FAMILIES["pit"], name="broken", build=BROKEN[problem])
    with pytest.raises(ArriveError, match=rf"'broken' with depth 0\.5 m .*{problem}"):
        build_tile(family, 0.5, np.random.default_rng(0), layout)


def test_a_gap_that_swallows_all_targets_is_refused():
    with pytest.raises(ArriveError, match=r"'gap' with width 4 m"):
        build_tile(FAMILIES["gap"], 4.0, np.random.default_rng(0), "training")


def test_targets_are_looked_for_where_training_draws_them():
    """Before the first gap, 1.2 m away, there is nothing to cross; a task that sends nobody farther says so at once."""
    near = (0.2, 0.7)
    with pytest.raises(ArriveError, match=r"'gap' .* 0\.0% of the targets at 0\.2 to 0\.7 m are valid and beyond it"):
        build_tile(FAMILIES["gap"], 0.2, np.random.default_rng(0), "training", target_distance=near)
    config = make_config(parse_families("gap"), num_envs=1, overrides=(f"task.target_distance={list(near)}",))
    with pytest.raises(ArriveError, match=r"targets at 0\.2 to 0\.7 m"):
        build_env(config)


def test_names():
    assert [family.name for family in parse_families("pit, gap")] == ["pit", "gap"]
    assert parse_families("all") == tuple(FAMILIES.values())
    with pytest.raises(ArriveError, match=r"unknown terrain 'stair'.*'stairs'.*pit.*stairs_down"):
        get_family("stair")
    with pytest.raises(ArriveError, match="more than once"):
        parse_families("pit,gap,pit")
    for empty in ("", "pit,"):
        with pytest.raises(ArriveError, match="empty terrain name"):
            parse_families(empty)


def test_target_share_is_uniform_in_radius():
    """Half of the radii from 1 to 5 m are below 3 m, although that disc has much less than half of the area."""
    x, y = np.meshgrid(cell_centers(), cell_centers(), indexing="ij")
    assert target_share(np.hypot(x, y) < 3.0, (1.0, 5.0)) == pytest.approx(0.5, abs=0.02)
    assert target_share(np.hypot(x, y) < 3.0, (2.0, 6.0)) == pytest.approx(0.25, abs=0.02)


def test_dilation_grows_a_cell_to_a_disc():
    mask = np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool)
    mask[140, 0] = True
    i, j = np.indices(mask.shape)
    np.testing.assert_array_equal(dilate(mask, 0.5), np.hypot(i - 140, j) <= 10)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [0.5, 1.5])
@pytest.mark.parametrize("name", FAMILIES)
def test_tiles_fit_robots_of_other_sizes(name, size, layout):
    """Every family passes `build_tile`'s checks, and what lies ahead begins farther away for a larger robot."""
    family = FAMILIES[name]
    for value in (family.lowest, family.highest):
        build_tile(family, value, np.random.default_rng(0), layout, size)
    tile = build_tile(family, family.highest, np.random.default_rng(0), layout, size)
    ahead = tile.heights[cell_index(np.array(0.0)) :, cell_index(np.array(0.0))]
    uneven = np.flatnonzero(np.abs(ahead) > 1e-6)
    if name != "flat" and len(uneven):
        assert uneven[0] * RASTER_CELL >= 0.4 * size - RASTER_CELL
