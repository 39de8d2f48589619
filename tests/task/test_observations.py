"""Each observation term against a hand computation, and heights against rays."""

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig, from_dict
from arrive.env import POLICY, ArriveEnv
from arrive.presets import PAPER_REWARDS, robust
from arrive.robots import get_robot
from arrive.task.final import FinalConfig
from arrive.task.heights import FootHeightsConfig, HeightGrid, HeightsConfig
from arrive.task.observations import Observer, observation_terms
from arrive.terrain import FAMILIES
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF, cell_index

TERMS = (
    "base_lin_vel",
    "base_ang_vel",
    "gravity",
    "target",
    "time_left",
    "joint_pos",
    "joint_vel",
    "action",
    "heights",
)
SIZES = (3, 3, 3, 3, 1, 12, 12, 12, 17 * 11)
PAPER_HEIGHTS, NOT_OBSERVED = HeightsConfig(), FootHeightsConfig()
NOISY = {"base_lin_vel", "base_ang_vel", "gravity", "joint_pos", "joint_vel", "heights"}


def an_env(
    num_envs: int,
    families: tuple[str, ...] = ("flat",),
    noise: bool = False,
    heights: HeightsConfig = PAPER_HEIGHTS,
    feet: FootHeightsConfig = NOT_OBSERVED,
) -> ArriveEnv:
    """Robots on the first family's hardest level, the second's, and so on; nothing happens to them."""
    config = Config(
        num_envs=num_envs,
        terrain=TerrainConfig(families=families, variants=1),
        observation=ObservationConfig(noise=noise, heights=heights, foot_heights=feet),
        randomisation=RandomisationConfig(push_speed=0.0),
        task=FinalConfig(rewards=PAPER_REWARDS),
    )
    values = tuple((FAMILIES[name].highest,) for name in families)
    assignment = (torch.arange(num_envs) % len(families), torch.zeros(num_envs, dtype=torch.long))
    return build_env(config, Placement(values=values, assignment=assignment), threads=1)


def random_states(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """qpos and qvel of tilted, turned, moving robots all over the tile."""
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-4, 4, (n, 2)), rng.uniform(0.3, 0.8, n)])
    quat = np.column_stack([rng.normal(0, 1, n), rng.normal(0, 0.2, (n, 2)), rng.normal(0, 1, n)])
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return np.column_stack([position, quat, rng.normal(0, 0.5, (n, 12))]), rng.normal(0, 1, (n, 18))


def put(env: ArriveEnv, qpos: np.ndarray, qvel: np.ndarray) -> None:
    """Put the robots into states and let the environment read them."""
    env.physics.reset(torch.arange(len(qpos)), torch.from_numpy(qpos), torch.from_numpy(qvel))
    env.load_state_dict(env.state_dict())


def sensed(env: ArriveEnv) -> dict[str, np.ndarray]:
    """The observation's terms, by name and in their units."""
    observation = env.get_observations()[POLICY].numpy()
    return {row["name"]: observation[:, row["start"] : row["stop"]] / row["scale"] for row in env.observer.schema()}


def rotation(quat: np.ndarray) -> np.ndarray:
    """(3, 3) base to world."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def test_slices_cover_the_observation_without_gaps():
    env = an_env(1)
    schema = env.observer.schema()
    assert [(row["name"], row["stop"] - row["start"]) for row in schema] == list(zip(TERMS, SIZES, strict=True))
    assert schema[0]["start"] == 0
    assert [row["stop"] for row in schema[:-1]] == [row["start"] for row in schema[1:]]
    assert schema[-1]["stop"] == env.observer.size == env.get_observations()[POLICY].shape[1] == sum(SIZES)
    assert all(len(row["labels"]) == row["stop"] - row["start"] for row in schema)


def test_base_terms_of_a_robot_that_looks_left():
    """Turned by 90 degrees: what is ahead in the world is to its right."""
    env = an_env(1)
    qpos, qvel = np.zeros((1, 19)), np.zeros((1, 18))
    qpos[0, :7] = 1.0, 2.0, 0.6, 0.5**0.5, 0.0, 0.0, 0.5**0.5
    qvel[0, :6] = 0.5, 0.0, 0.1, 0.01, 0.02, 0.03
    put(env, qpos, qvel)
    env.task.command.target_w[:] = torch.tensor([4.0, 2.0, 0.5])
    terms = sensed(env)
    np.testing.assert_allclose(terms["target"], [[0.0, -3.0, -0.1]], atol=1e-6)
    np.testing.assert_allclose(terms["base_lin_vel"], [[0.0, -0.5, 0.1]], atol=1e-6)
    np.testing.assert_allclose(terms["base_ang_vel"], [[0.01, 0.02, 0.03]], atol=1e-6)
    np.testing.assert_allclose(terms["gravity"], [[0.0, 0.0, -1.0]], atol=1e-6)


def test_base_terms_of_a_robot_that_looks_down():
    """Pitched by 30 degrees: gravity pulls it forward, and a target at its height is ahead of and above its nose."""
    env = an_env(1)
    qpos = np.zeros((1, 19))
    qpos[0, :7] = 0.0, 0.0, 0.5, np.cos(np.pi / 12), 0.0, np.sin(np.pi / 12), 0.0
    put(env, qpos, np.zeros((1, 18)))
    env.task.command.target_w[:] = torch.tensor([2.0, 0.0, 0.5])
    terms = sensed(env)
    np.testing.assert_allclose(terms["gravity"], [[0.5, 0.0, -(0.75**0.5)]], atol=1e-6)
    np.testing.assert_allclose(terms["target"], [[2 * 0.75**0.5, 0.0, 1.0]], atol=1e-6)


def test_terms_of_robots_in_random_states():
    env = an_env(6)
    action = torch.randn(6, 12)
    env.step(action)
    qpos, qvel = random_states(6)
    put(env, qpos, qvel)
    env.task.command.time_left_s[:] = torch.tensor([6.0, 3.0, 1.5, 1.0, 0.02, 0.0])
    terms = sensed(env)
    target = env.task.command.target_w.numpy()
    for i in range(6):
        to_base = rotation(qpos[i, 3:7]).T
        np.testing.assert_allclose(terms["base_lin_vel"][i], to_base @ qvel[i, :3], atol=1e-5)
        np.testing.assert_allclose(terms["base_ang_vel"][i], qvel[i, 3:6], atol=1e-5)
        np.testing.assert_allclose(terms["gravity"][i], to_base @ [0, 0, -1], atol=1e-5)
        np.testing.assert_allclose(terms["target"][i], to_base @ (target[i] - qpos[i, :3]), atol=1e-5)
    np.testing.assert_allclose(terms["time_left"][:, 0], [6.0, 3.0, 1.5, 1.0, 0.02, 0.0], atol=1e-6)
    np.testing.assert_allclose(terms["joint_pos"], qpos[:, 7:] - env.robot.default_joint_pos, atol=1e-5)
    np.testing.assert_allclose(terms["joint_vel"], qvel[:, 6:], atol=1e-4)
    np.testing.assert_allclose(terms["action"], action, atol=1e-6)


def test_the_observed_time_left_is_at_most_the_longest_episode_in_training():
    env = an_env(3)
    env.task.command.time_left_s[:] = torch.tensor([8.0, 6.02, 5.98])
    np.testing.assert_allclose(sensed(env)["time_left"][:, 0], [6.0, 6.0, 5.98], atol=1e-6)


def test_the_height_grid_lies_before_a_robot_as_its_labels_say():
    """A step that only the left half of the grid is over shows in the labels with y > 0."""
    env = an_env(1, ("pit",))
    qpos = np.zeros((1, 19))
    # It looks along +y, so its left is -x, and the wall of the pit at x = -1.5 is 0.25 m to its left.
    qpos[0, :7] = -1.25, 0.0, 0.7, 0.5**0.5, 0.0, 0.0, 0.5**0.5
    put(env, qpos, np.zeros((1, 18)))
    heights = sensed(env)["heights"][0]
    labels = [tuple(map(float, label.strip("()").split(","))) for label in env.observer.schema()[-1]["labels"]]
    assert len(set(labels)) == len(labels)
    assert (min(labels), max(labels)) == ((-0.8, -0.5), (0.8, 0.5))
    expected = [0.7 - 0.5 - 1.1 if y > 0.25 else 0.7 - 0.5 for _, y in labels]
    np.testing.assert_allclose(heights, expected, atol=1e-5)


def test_the_labels_of_the_height_grid_are_its_cells():
    """Also on the grid of the preset `robust`, whose cells are 0.125 m apart."""
    for heights in (HeightsConfig(), robust().observation.heights):
        terms = observation_terms(get_robot("anymal_c"), ObservationConfig(heights=heights), 6.0)
        cells = [tuple(map(float, label.strip("()").split(","))) for label in terms[-1].labels]
        np.testing.assert_allclose(cells, HeightGrid(heights).cells, atol=1e-6)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_the_points_of_a_height_grid_are_regular_and_surround_their_cells(samples):
    grid = HeightGrid(HeightsConfig(length=0.4, width=0.2, step=0.1, samples=samples))
    x, y = (torch.unique(column.round(decimals=5)) for column in grid.points.T)
    assert (len(x), len(y)) == (5 * samples, 3 * samples)
    for along in (x, y):
        np.testing.assert_allclose(along.diff(), 0.1 / samples, atol=1e-5)
    for column in range(2):
        np.testing.assert_allclose(grid.pooled(grid.points[None, :, column])[0], grid.cells[:, column], atol=1e-6)
    spread = grid.spread(grid.cells.T)
    assert ((spread.T - grid.points).abs() < 0.1 / 2).all()
    np.testing.assert_allclose(grid.pooled(spread), grid.cells.T, atol=1e-6)


def test_a_height_sample_is_the_mean_of_the_clipped_heights_of_its_points():
    """A robot 0.03 m before a pit's wall, which is higher than the clip: half of a cell's points are on it."""
    heights = HeightsConfig(length=0.4, width=0.2, step=0.1, clip=(-0.3, 0.4), samples=2)
    env = an_env(1, ("pit",), heights=heights)
    qpos = np.zeros((1, 19))
    qpos[0, :7] = 1.4, 0.0, 0.7, 1.0, 0.0, 0.0, 0.0  # the wall at x = 1.5 runs through the cells 0.1 m ahead
    put(env, qpos, np.zeros((1, 18)))
    rows = sensed(env)["heights"][0].reshape(5, 3)
    np.testing.assert_allclose(rows[:3], 0.2, atol=1e-5)
    np.testing.assert_allclose(rows[3], (0.2 - 0.3) / 2, atol=1e-5)
    np.testing.assert_allclose(rows[4], -0.3, atol=1e-5)


def grid_cells(qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(187,) raster indices of the cells under a robot's grid: 17 by 11 points, 0.1 m apart, turned by its heading."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.5, 0.5, 11), indexing="ij"))
    forward = rotation(qpos[3:7])[:2, 0] / np.linalg.norm(rotation(qpos[3:7])[:2, 0])
    return cell_index(qpos[0] + forward[0] * x - forward[1] * y), cell_index(qpos[1] + forward[1] * x + forward[0] * y)


def ray_height(model: mujoco.MjModel, data: mujoco.MjData, x: float, y: float) -> float:
    """Height of the terrain, which is in geom group 0 [m]."""
    only_terrain, geom_id = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8), np.array([-1], dtype=np.int32)
    distance = mujoco.mj_ray(model, data, np.array([x, y, 20.0]), np.array([0, 0, -1.0]), only_terrain, 1, -1, geom_id)
    assert distance >= 0
    return 20.0 - distance


def test_heights_are_those_that_rays_find_on_every_family():
    names = tuple(FAMILIES)
    env = an_env(2 * len(names), names)
    qpos, qvel = random_states(env.num_envs, seed=1)
    put(env, qpos, qvel)
    heights = sensed(env)["heights"]
    for i in range(env.num_envs):
        model = env.physics.model_of_env(i)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        rows, columns = grid_cells(qpos[i])
        centers = ((np.stack([rows, columns]) + 0.5) * RASTER_CELL - RASTER_HALF).T
        ground = np.array([ray_height(model, data, *center) for center in centers])
        name = names[i % len(names)]
        assert np.ptp(ground) > 0.01 or name in {"flat", "obstacles", "gap", "pit"}, "nothing to see"
        # A point within float32's error of a cell's edge may be looked up in its neighbour.
        error = np.abs(heights[i] - np.clip(qpos[i, 2] - 0.5 - ground, -1.0, 1.0))
        assert (error < 1e-4).mean() > 0.99, name
        tile = env.pool.tiles[env.tile_of_env[i]]
        np.testing.assert_allclose(tile.heights[rows, columns], ground, atol=1e-4, err_msg=name)


def test_foot_heights_are_those_of_the_grids_points_nearest_to_each_foots_samples():
    """On steps, for robots in all poses, from the foot's place by MuJoCo and rays through the grid's points."""
    fine = HeightsConfig(length=2.0, width=1.25, step=0.125, samples=3)
    env = an_env(12, ("steps",), heights=fine, feet=FootHeightsConfig(enabled=True, length=0.2, width=0.08, step=0.04))
    qpos, qvel = random_states(env.num_envs, seed=2)
    put(env, qpos, qvel)
    found, points = sensed(env)["foot_heights"], HeightGrid(fine).points.numpy()
    assert found.shape == (12, 4 * 6 * 3)
    agree, beside = [], 0
    for i in range(env.num_envs):
        model = env.physics.model_of_env(i)
        data = mujoco.MjData(model)
        data.qpos[:] = qpos[i]
        mujoco.mj_forward(model, data)
        forward = rotation(qpos[i, 3:7])[:2, 0] / np.linalg.norm(rotation(qpos[i, 3:7])[:2, 0])
        left = np.array([-forward[1], forward[0]])
        samples = found[i].reshape(4, 6, 3)
        for foot, site in enumerate(env.robot.foot_sites):
            off = data.site(site).xpos[:2] - qpos[i, :2]
            for row, column in np.ndindex(6, 3):
                place = np.array([off @ forward - 0.1 + 0.04 * row, off @ left - 0.04 + 0.04 * column])
                x, y = points[np.linalg.norm(points - place, axis=1).argmin()]
                beside += np.linalg.norm(place - (x, y)) > 0.03
                cell = cell_index(qpos[i, :2] + x * forward + y * left)
                center = (np.array(cell) + 0.5) * RASTER_CELL - RASTER_HALF
                ground = ray_height(model, data, *center)
                agree.append(abs(samples[foot, row, column] - np.clip(qpos[i, 2] - 0.5 - ground, -1.0, 1.0)) < 1e-4)
    assert np.mean(agree) > 0.98
    assert 0 < beside < 0.2 * len(agree), "no sample lay outside the grid"
    assert (np.ptp(found, axis=1) > 0.1).mean() > 0.5, "the feet stand on flat ground"


def test_the_policy_does_not_observe_foot_heights_unless_they_are_enabled():
    assert "foot_heights" not in sensed(an_env(1))
    names = [row["name"] for row in an_env(1, feet=FootHeightsConfig(enabled=True)).observer.schema()]
    assert names == [*TERMS[:-1], "foot_heights", "heights"]


def noise_of(env: ArriveEnv, samples: int) -> dict[str, Tensor]:
    """Noise of many observations of one state, in the terms' units: (samples * num_envs, size) by term."""
    clean = Observer(env.observer.terms, False, env.device).observe(env.state, env.task.command, torch.Generator())
    noise = torch.cat([env.get_observations()[POLICY] - clean for _ in range(samples)])
    schema = env.observer.schema()
    return {row["name"]: noise[:, row["start"] : row["stop"]] / row["scale"] for row in schema}


def test_noise_is_uniform_within_its_bounds():
    env = an_env(50, noise=True)
    noise = noise_of(env, 40)
    for term in env.observer.terms:
        values = noise[term.name]
        assert (term.noise > 0) == (term.name in NOISY)
        if not term.noise:
            assert not values.any(), f"{term.name} is known exactly"
            continue
        # Every entry of its own: none is left out, none is shared.
        assert float(values.abs().max()) <= term.noise * 1.001 + 1e-5
        assert float(values.amax(0).min()) > 0.99 * term.noise
        assert float(values.amin(0).max()) < -0.99 * term.noise
        assert float(values.mean(0).abs().max()) < 5 * term.noise / (3 * len(values)) ** 0.5
        torch.testing.assert_close(values.std(0), torch.full((term.size,), term.noise / 3**0.5), rtol=0.06, atol=0.0)
        if term.size > 1:
            assert abs(float(torch.corrcoef(values[:, :2].T)[0, 1])) < 5 / len(values) ** 0.5


def test_noise_factors_are_evenly_spaced_from_noise_least_to_one():
    env = an_env(5, noise=True)
    env.observer = Observer(env.observer.terms, True, env.device, noise_least=0.2)
    noise = noise_of(env, 40)["heights"].view(40, 5, -1).abs().amax((0, 2))
    bound = next(term.noise for term in env.observer.terms if term.name == "heights")
    torch.testing.assert_close(noise / bound, torch.tensor([0.2, 0.4, 0.6, 0.8, 1.0]), rtol=0.01, atol=0.0)


def test_noise_follows_the_configuration_of_each_term():
    """Half-widths reach the terms they are meant for."""
    figures = {
        "base_lin_vel": 0.11,
        "base_ang_vel": 0.22,
        "gravity": 0.033,
        "joint_pos": 0.044,
        "joint_vel": 0.55,
        "heights": 0.066,
    }
    observation = from_dict(ObservationConfig, figures)
    config = Config(num_envs=20, observation=observation, task=FinalConfig(rewards=PAPER_REWARDS))
    noise = noise_of(build_env(config, threads=1), 50)
    for name, figure in figures.items():
        assert float(noise[name].abs().max()) == pytest.approx(figure, rel=0.01), name


def test_without_noise_observations_repeat():
    env = an_env(2)
    assert torch.equal(env.get_observations()[POLICY], env.get_observations()[POLICY])
