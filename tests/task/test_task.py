"""Targets, deadlines, arrival, terrain levels and the end of the exploration reward."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.config import Config, TerrainConfig
from arrive.errors import ArriveError
from arrive.presets import PAPER_REWARDS, PRESETS, get_preset
from arrive.task.curriculum import ExplorationSwitch, LevelCurriculum, assign_families
from arrive.task.final import FinalConfig, FinalPositionTask
from arrive.task.heights import look_up
from arrive.task.rewards import bound, task_share
from arrive.task.state import Command, State
from arrive.task.targets import sample_targets
from arrive.task.task import Start, TaskContext, Trial
from arrive.terrain import FAMILIES, build_tile
from arrive.terrain.rasters import stack_rasters
from arrive.terrain.tile import RASTER_HALF, RASTER_SIZE, Tile, cell_index

MANY = 20_000
START = (0.15, -0.2, 0.6)
TASK = FinalConfig(rewards=PAPER_REWARDS)


def tile_of(family: str, share: float = 1.0) -> Tile:
    """The family's tile at this share of its range of difficulty."""
    kind = FAMILIES[family]
    return build_tile(kind, kind.lowest + share * (kind.highest - kind.lowest), np.random.default_rng(0), "training")


def starts(n: int) -> Tensor:
    return torch.tensor([START]).expand(n, 3)


def targets_on(tile: Tile, n: int = MANY, config: FinalConfig = TASK) -> np.ndarray:
    tile_ids = torch.zeros(n, dtype=torch.long)
    return sample_targets(stack_rasters([tile]), tile_ids, starts(n), config, torch.Generator().manual_seed(0)).numpy()


def crossing_share(tile: Tile, share: float) -> float:
    """How many of the targets count as crossing when this share of them is drawn only there."""
    targets = targets_on(tile, config=replace(TASK, crossing_share=share))
    tile_ids = torch.zeros(MANY, dtype=torch.long)
    points = torch.from_numpy(targets[:, None, :2])
    assert bool(look_up(stack_rasters([tile]).target_valid, tile_ids, points).all())
    return float(look_up(stack_rasters([tile]).crossing, tile_ids, points).float().mean())


def distance_from_uniform(samples: np.ndarray, low: float, high: float) -> float:
    """Kolmogorov's distance between the samples and the uniform distribution, times the root of their number."""
    order = (np.sort(samples) - low) / (high - low)
    ranks = np.arange(len(samples) + 1) / len(samples)
    return max(np.abs(order - ranks[1:]).max(), np.abs(order - ranks[:-1]).max()) * len(samples) ** 0.5


class TestTargets:
    def test_are_uniform_in_radius_and_angle_around_the_start(self):
        offset = targets_on(tile_of("flat"))[:, :2] - START[:2]
        radius, angle = np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0])
        # Above 1.63 one sample of the uniform distribution in a hundred.
        assert distance_from_uniform(radius, 1.0, 5.0) < 1.63
        assert distance_from_uniform(angle, -math.pi, math.pi) < 1.63
        assert distance_from_uniform(angle[radius < 2.0], -math.pi, math.pi) < 1.63
        assert radius.min() >= 1.0 - 1e-5
        assert radius.max() <= 5.0 + 1e-5

    @pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
    def test_are_never_in_a_gap_or_at_its_edge(self, share):
        points = targets_on(tile_of("gap", share))
        width = FAMILIES["gap"].lowest + share * (FAMILIES["gap"].highest - FAMILIES["gap"].lowest)
        outwards = np.abs(points[:, :2]).max(-1)
        near = (outwards > 1.2 - 0.3) & (outwards < 1.2 + width + 0.2)
        assert not near.any()
        assert (outwards < 1.2).any()
        assert (outwards > 1.2 + width).any()
        np.testing.assert_allclose(points[:, 2], 0.5)

    @pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
    def test_are_never_on_or_beside_an_obstacle(self, share):
        tile = tile_of("obstacles", share)
        points = targets_on(tile)
        for pillar in tile.boxes[1:]:
            outside = np.abs(points[:, :2] - pillar.center[:2]) - pillar.half_size[:2]
            assert np.linalg.norm(np.maximum(outside, 0.0), axis=-1).min() > 0.42
        np.testing.assert_allclose(points[:, 2], 0.5)

    @pytest.mark.parametrize("share", [0.0, 1.0])
    def test_are_never_astride_the_wall_of_a_pit_and_above_the_ground_they_are_on(self, share):
        points = targets_on(tile_of("pit", share))
        depth = FAMILIES["pit"].lowest + share * (FAMILIES["pit"].highest - FAMILIES["pit"].lowest)
        outwards = np.abs(points[:, :2]).max(-1)
        beyond = np.linalg.norm(np.maximum(np.abs(points[:, :2]) - 1.5, 0.0), axis=-1)
        assert np.where(outwards > 1.5, beyond, 1.5 - outwards).min() > 0.27
        np.testing.assert_allclose(points[:, 2], np.where(outwards > 1.5, 0.5 + depth, 0.5), rtol=1e-6)

    def test_are_half_a_metre_above_a_slope(self):
        points = targets_on(tile_of("slope", 0.5))
        rise = math.tan(math.radians(27.5))
        ground = np.maximum(np.abs(points[:, :2]).max(-1) - 1.0, 0.0) * rise
        # The ground is looked up at the centre of a 5 cm cell.
        np.testing.assert_allclose(points[:, 2], ground + 0.5, atol=0.0251 * rise)

    def test_are_found_on_a_tile_where_few_places_are_valid(self):
        tile, valid = tile_of("flat"), np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool)
        valid[cell_index(np.array(2.0)) : cell_index(np.array(3.0)), cell_index(np.array(0.0))] = True
        points = targets_on(replace(tile, target_valid=valid), 50)
        assert valid[cell_index(points[:, 0]), cell_index(points[:, 1])].all()

    def test_that_cannot_be_found_are_an_error(self):
        nowhere = np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool)
        with pytest.raises(ArriveError, match="no valid target"):
            targets_on(replace(tile_of("flat"), target_valid=nowhere), 2)

    def test_crossing_share_of_the_targets_is_beyond_the_terrain(self):
        tile = tile_of("obstacles", 0.3)
        anywhere = crossing_share(tile, 0.0)
        assert 0.1 < anywhere < 0.6
        assert crossing_share(tile, 0.5) == pytest.approx((1.0 + anywhere) / 2, abs=0.03)
        assert crossing_share(tile, 1.0) > 0.995

    def test_nearest_share_of_those_targets_is_just_beyond_the_terrain(self):
        tile = tile_of("gap", 0.2)
        rasters, tile_ids = stack_rasters([tile]), torch.zeros(MANY, dtype=torch.long)

        def close(share: float) -> float:
            """How many targets are within 0.3 m of the nearest place beyond the gap."""
            config = replace(TASK, target_distance=(0.5, 5.5), crossing_share=1.0, nearest_share=share)
            targets = torch.from_numpy(targets_on(tile, config=config))
            assert look_up(rasters.crossing, tile_ids, targets[:, None, :2]).float().mean() > 0.995
            edge = targets[:, :2].abs().amax(-1)
            return float((edge < edge.min() + 0.3).float().mean())

        assert close(1.0) > close(0.0) + 0.3
        assert close(0.25) == pytest.approx(0.75 * close(0.0) + 0.25 * close(1.0), abs=0.02)

    def test_without_terrain_to_cross_targets_are_anywhere(self):
        tile = tile_of("flat")
        assert crossing_share(replace(tile, crossing=np.zeros_like(tile.crossing)), 1.0) == 0.0


def a_task(tile: Tile, n: int, config: FinalConfig = TASK, **options) -> FinalPositionTask:
    setting = TaskContext(n, 0.02, stack_rasters([tile]), torch.Generator().manual_seed(0))
    return FinalPositionTask(config, setting, **options)


def begin(task: FinalPositionTask, n: int, first: bool = False) -> None:
    task.new_command(Start(torch.arange(n), starts(n), torch.zeros(n, dtype=torch.long)), first)


class TestRetargeting:
    """Another target on the way, where it is asked for."""

    def test_new_targets_come_at_the_configured_rate_with_a_new_time(self):
        task = a_task(tile_of("flat"), MANY, replace(TASK, retarget_s=2.0))
        begin(task, MANY)
        task.advance(3.0)
        before = task.command.target_w.clone()
        task.retarget(a_state(MANY, base_pos_w=torch.tensor([[3.0, 1.0, 0.6]]).expand(MANY, 3)))
        moved = (task.command.target_w != before).any(-1)
        assert float(moved.float().mean()) == pytest.approx(0.02 / 2.0, rel=0.5)
        assert task.command.time_left_s[moved].tolist() == pytest.approx([6.0] * int(moved.sum()))
        assert task.command.time_left_s[~moved].tolist() == pytest.approx([3.0] * int((~moved).sum()))
        offset = task.command.target_w[moved, :2] - torch.tensor([3.0, 1.0])
        assert float(offset.norm(dim=-1).min()) >= 1.0 - 1e-5
        assert float(offset.norm(dim=-1).max()) <= 5.0 + 1e-5

    def test_there_are_no_new_targets_by_default_and_in_trials(self):
        trial = Trial(duration_s=8.0, target=(5.0, 0.0), speed=1.0, walk=4.0)
        for task in (
            a_task(tile_of("flat"), 50),
            a_task(tile_of("flat"), 50, replace(TASK, retarget_s=0.02), trial=trial),
        ):
            begin(task, 50)
            before = task.command.target_w.clone()
            task.retarget(a_state(50))
            assert torch.equal(task.command.target_w, before)

    def test_a_target_beyond_a_gap_does_not_count_for_a_robot_that_is_beyond_it_already(self):
        task = a_task(tile_of("gap"), 400, replace(TASK, retarget_s=0.02))
        for x, counting in ((0.0, True), (4.0, False)):
            begin(task, 400)
            task.retarget(a_state(400, base_pos_w=torch.tensor([[x, 0.0, 0.6]]).expand(400, 3)))
            assert bool(task.command.crossing.any()) == counting

    def test_stop_share_of_the_new_targets_is_at_the_robot(self):
        task = a_task(tile_of("slope", 0.5), MANY, replace(TASK, retarget_s=0.02, stop_share=0.25))
        begin(task, MANY)
        task.command.crossing[:] = True
        task.retarget(a_state(MANY, base_pos_w=torch.tensor([[3.0, 0.0, 1.7]]).expand(MANY, 3)))
        stops = (task.command.target_w[:, :2] == torch.tensor([3.0, 0.0])).all(-1)
        assert float(stops.float().mean()) == pytest.approx(0.25, abs=0.02)
        # Half a metre above the slope of 27.5 degrees that begins 1 m out, looked up in cells of 5 cm.
        expected = 2.0 * math.tan(math.radians(27.5)) + 0.5
        assert task.command.target_w[stops, 2].tolist() == pytest.approx([expected] * int(stops.sum()), abs=0.03)
        assert not bool(task.command.crossing[stops].any())
        assert float((task.command.target_w - torch.tensor([3.0, 0.0, 1.7]))[~stops].norm(dim=-1).min()) > 0.9

    def test_targets_stay_on_the_tile(self):
        tile = tile_of("flat")
        corner = torch.tensor([[6.0, 6.0, 0.6]]).expand(MANY, 3)
        ids, generator = torch.zeros(MANY, dtype=torch.long), torch.Generator().manual_seed(0)
        targets = sample_targets(stack_rasters([tile]), ids, corner, TASK, generator)
        assert float(targets[:, :2].abs().max()) < RASTER_HALF - 0.4


class TestCommand:
    def test_every_episode_of_the_paper_takes_six_seconds(self):
        task = a_task(tile_of("flat"), 5)
        begin(task, 5)
        steps = [bool(task.advance(0.02).any()) for _ in range(300)]
        assert steps == [False] * 299 + [True]
        assert bool((task.command.time_left_s.abs() < 1e-3).all())

    @pytest.mark.parametrize("window_s", [1.0, 2.0])
    def test_the_window_holds_as_many_steps_as_fit_in_it(self, window_s):
        """The clock counts down in float32; it must not slip a step into the window or out of it."""
        config = replace(TASK, reward_window_s=window_s)
        task, state = a_task(tile_of("flat"), 1, config), a_state(1)
        begin(task, 1)
        state.base_pos_w = task.command.target_w
        earned = 0.0
        for _ in range(300):
            task.advance(0.02)
            earned += 0.02 * float(bound("task", config)(state, task.command))
        assert earned == pytest.approx(1.0, abs=1e-5)

    def test_lengths_are_uniform_between_the_shortest_and_the_longest(self):
        task = a_task(tile_of("flat"), MANY, replace(TASK, episode_min_s=4.0))
        begin(task, MANY)
        # Rounded to policy steps or not: a step is 1 % of the range.
        assert distance_from_uniform(task.command.time_left_s.numpy(), 4.0, 6.0) < 1.63 + 0.01 * MANY**0.5

    def test_first_episodes_are_spread_and_do_not_count(self):
        task = a_task(tile_of("flat"), MANY)
        begin(task, MANY, first=True)
        assert distance_from_uniform(task.command.time_left_s.numpy(), 0.0, 6.0) < 1.63 + 0.01 * MANY**0.5
        assert not task.command.crossing.any()

    def test_a_target_counts_when_it_is_across_the_terrain(self):
        task = a_task(tile_of("gap"), 500)
        begin(task, 500)
        across = task.command.target_w[:, :2].abs().amax(-1) > 1.2 + 1.4
        assert 0 < int(across.sum()) < 500
        assert torch.equal(task.command.crossing, across)

    def test_knows_its_start_distance(self):
        task = a_task(tile_of("flat"), 10)
        begin(task, 10)
        offset = task.command.target_w - starts(10)
        torch.testing.assert_close(task.command.start_distance, offset.square().sum(-1).sqrt())

    def test_a_fixed_target_stands_above_its_ground(self):
        task = a_task(tile_of("pit"), 3, trial=Trial(8.0, (5.0, 0.0), 1.0, 4.0))
        begin(task, 3)
        torch.testing.assert_close(task.command.target_w, torch.tensor([[5.0, 0.0, 1.1 + 0.5]]).expand(3, 3))

    def test_only_the_robots_that_start_get_a_new_one(self):
        task = a_task(tile_of("flat"), 4)
        begin(task, 4)
        before = task.state_dict()
        task.advance(0.02)
        task.new_command(Start(torch.tensor([2]), starts(1), torch.zeros(1, dtype=torch.long)), False)
        moved = (task.command.target_w != before["target_w"]).any(-1)
        assert moved.tolist() == [False, False, True, False]
        assert task.command.time_left_s.tolist() == pytest.approx([5.98, 5.98, 6.0, 5.98])


def a_state(n: int, **values) -> State:
    """States whose fields are zero unless given; vectors where the task reads any."""
    return State(**{field.name: torch.zeros(n, 3) for field in fields(State)} | values)


def judged(distance: float, *, start=4.0, crashed=False, fell=False, counts=True, speed=1.0) -> dict:
    """The outcome of one robot that ends this far from its target."""
    task = a_task(tile_of("flat"), 1)
    begin(task, 1)
    task.command.start_distance[:], task.command.crossing[:] = start, counts
    # Along all three axes: the distance is not a horizontal one.
    position = task.command.target_w + torch.tensor([[2.0, -2.0, 1.0]]) / 3.0 * distance
    state = a_state(1, base_pos_w=position, base_lin_vel_w=torch.tensor([[speed, 0.0, 0.0]]))
    outcome = task.judge(state, torch.tensor([crashed]), torch.tensor([fell]))
    cause = [name for name, mask in outcome.failures.items() if mask]
    assert len(cause) == (not outcome.success), "every failure has exactly one cause"
    verdict = {name: bool(getattr(outcome, name)) for name in ("success", "promote", "demote")}
    return verdict | {"cause": cause[0] if cause else None}


class TestJudgement:
    def test_arrival_is_half_a_metre(self):
        assert judged(0.49) == {"success": True, "promote": True, "demote": False, "cause": None}
        assert judged(0.51) == {"success": False, "promote": False, "demote": True, "cause": "late"}

    def test_a_crash_at_the_target_is_no_arrival(self):
        for accident in ({"crashed": True}, {"fell": True}, {"crashed": True, "fell": True}):
            verdict = judged(0.1, **accident)
            assert not verdict["success"]
            assert not verdict["promote"]
            assert verdict["cause"] == ("fell" if "fell" in accident else "crash")

    def test_a_stalled_robot_is_distinguished_from_a_late_one(self):
        assert judged(2.0, speed=0.09)["cause"] == "stalled"
        assert judged(2.0, speed=0.11)["cause"] == "late"

    def test_a_target_that_needs_no_crossing_does_not_change_the_level(self):
        for distance, crashed in ((0.1, False), (3.0, False), (3.0, True)):
            verdict = judged(distance, crashed=crashed, counts=False)
            assert not verdict["promote"]
            assert not verdict["demote"]
        assert judged(0.1, counts=False)["success"]


def test_robots_are_assigned_to_families_in_turn():
    assert assign_families(7, 3).tolist() == [0, 1, 2, 0, 1, 2, 0]


def levels_after(level: int, num_levels: int, *, ended=True, promote=False, demote=False, n: int = 1) -> Tensor:
    curriculum = LevelCurriculum(torch.full((n,), num_levels), torch.Generator().manual_seed(0))
    assert not curriculum.levels.any()
    curriculum.levels[:] = level
    curriculum.update(*(torch.full((n,), flag) for flag in (ended, promote, demote)))
    return curriculum.levels


class TestLevels:
    def test_go_up_after_a_success_and_down_after_a_failure(self):
        assert levels_after(3, 10, promote=True).tolist() == [4]
        assert levels_after(3, 10, demote=True).tolist() == [2]
        assert levels_after(3, 10).tolist() == [3]

    def test_stay_while_the_episode_goes_on(self):
        assert levels_after(3, 10, ended=False, promote=True).tolist() == [3]
        assert levels_after(3, 10, ended=False, demote=True).tolist() == [3]

    def test_demotion_share_of_the_failures_lowers_the_level(self):
        """With a quarter of them, where one episode in five succeeds; of level 8, (10 - level) / 10 succeed."""
        n, rng = 4000, torch.Generator().manual_seed(1)
        curriculum = LevelCurriculum(torch.full((n,), 20), torch.Generator().manual_seed(0))
        curriculum.levels[:] = 8
        everyone, nobody = torch.ones(n, dtype=torch.bool), torch.zeros(n, dtype=torch.bool)
        curriculum.update(everyone, nobody, everyone, demotion_share=0.25)
        assert float((curriculum.levels == 7).float().mean()) == pytest.approx(0.25, abs=0.035)
        for _ in range(100):
            success = torch.rand(n, generator=rng) < (10 - curriculum.levels) / 10
            curriculum.update(everyone, success, ~success, demotion_share=0.25)
        assert float(curriculum.levels.float().mean()) == pytest.approx(8.0, abs=0.3)

    def test_do_not_fall_below_the_first(self):
        assert levels_after(0, 10, demote=True).tolist() == [0]

    def test_after_the_last_level_comes_a_random_one(self):
        levels = levels_after(9, 10, promote=True, n=5000)
        # Within five standard deviations of 500 each.
        assert (torch.bincount(levels, minlength=10) - 500).abs().max() < 5 * (5000 * 0.1 * 0.9) ** 0.5
        assert levels_after(8, 10, promote=True, n=100).unique().tolist() == [9]

    def test_a_family_with_one_level_stays_on_it(self):
        assert levels_after(0, 1, promote=True, n=50).unique().tolist() == [0]

    def test_review_gives_an_easier_level_in_the_given_share(self):
        curriculum = LevelCurriculum(torch.full((9000,), 10), torch.Generator().manual_seed(0))
        curriculum.levels[:] = torch.tensor([0, 1, 4]).repeat(3000)
        dealt = curriculum.next_levels(torch.arange(9000), review=0.25).view(-1, 3)
        assert not dealt[:, 0].any()
        assert dealt[:, 1].unique().tolist() == [0, 1]
        counts = torch.bincount(dealt[:, 2], minlength=5)
        # Within five standard deviations.
        expected = 3000 * torch.tensor([0.0625, 0.0625, 0.0625, 0.0625, 0.75])
        assert ((counts - expected).abs() < 5 * expected.sqrt()).all()

    def test_without_review_episodes_are_on_the_robots_own_level(self):
        curriculum = LevelCurriculum(torch.full((50,), 10), torch.Generator().manual_seed(0))
        curriculum.levels[:] = torch.arange(50) % 10
        ids = torch.tensor([3, 40, 7])
        assert torch.equal(curriculum.next_levels(ids, review=0.0), curriculum.levels[ids])


FAR, NEAR = 10.0, 0.0
INSIDE, OUTSIDE = 0.5, 3.0


def a_switch(robots: int = 1, families: tuple[int, ...] | None = None) -> ExplorationSwitch:
    return ExplorationSwitch(torch.tensor(families or robots * (0,)))


def feed(switch: ExplorationSwitch, samples: list[tuple[float, float]], steps: int = 50, eligible=None) -> None:
    """Robots at these (distance to target, time left) for some policy steps."""
    n = len(samples)
    distance, time_left = torch.tensor(samples).unbind(-1)
    target = torch.stack([distance, torch.zeros(n), torch.zeros(n)], dim=-1)
    command = Command(target, time_left, torch.ones(n), torch.ones(n, dtype=torch.bool))
    everyone = torch.ones(n, dtype=torch.bool) if eligible is None else torch.tensor(eligible)
    for _ in range(steps):
        share, paid = task_share(a_state(n), command, reward_window_s=1.0)
        switch.record(share, (paid & everyone).float())


class TestExplorationSwitch:
    """The reward window is the last second."""

    def test_goes_when_robots_are_near_inside_the_window_although_the_mean_over_all_is_low(self):
        switch = a_switch(10)
        feed(switch, [(NEAR, INSIDE)] + 9 * [(FAR, OUTSIDE)])
        assert switch.fraction == pytest.approx(1.0)
        assert switch.factor.tolist() == 10 * [0.0]

    def test_stays_when_robots_are_far_inside_the_window_although_the_mean_over_all_is_high(self):
        switch = a_switch(10)
        feed(switch, [(3.0, INSIDE)] + 9 * [(NEAR, OUTSIDE)])
        assert switch.fraction == pytest.approx(0.1)
        assert switch.factor.tolist() == 10 * [1.0]

    @pytest.mark.parametrize(("distance", "factor"), [(0.999, 0.0), (1.001, 1.0)])
    def test_goes_at_half_of_the_maximum(self, distance, factor):
        switch = a_switch()
        feed(switch, [(distance, INSIDE)])
        assert switch.factor == factor

    def test_never_comes_back(self):
        switch = a_switch()
        feed(switch, [(NEAR, INSIDE)])
        feed(switch, [(FAR, INSIDE)], steps=500)
        assert switch.fraction < 0.5
        assert switch.factor == 0.0

    def test_looks_at_the_recent_past_only(self):
        switch = a_switch()
        feed(switch, [(FAR, INSIDE)], steps=1000)
        feed(switch, [(NEAR, INSIDE)])
        assert switch.factor == 0.0

    def test_goes_on_the_families_that_are_solved_and_stays_on_the_others(self):
        switch = a_switch(families=(0, 1, 0, 1))
        feed(switch, [(NEAR, INSIDE), (FAR, INSIDE), (NEAR, INSIDE), (NEAR, OUTSIDE)])
        assert switch.factor.tolist() == [0.0, 1.0, 0.0, 1.0]
        assert switch.paid == 0.5
        assert switch.fraction == pytest.approx(0.5, abs=0.01)

    def test_shortened_episodes_are_left_out(self):
        switch = a_switch(2)
        feed(switch, [(NEAR, INSIDE), (3.0, INSIDE)], eligible=[False, True])
        assert switch.fraction == pytest.approx(0.1)
        fresh = a_switch()
        feed(fresh, [(NEAR, INSIDE)], eligible=[False])
        assert fresh.factor == 1.0

    def test_without_samples_in_the_window_nothing_changes(self):
        switch = a_switch()
        feed(switch, [(NEAR, OUTSIDE)], steps=200)
        assert switch.factor == 1.0

    @pytest.mark.parametrize("before", [(FAR, 30), (NEAR, 30), (NEAR, 50)])
    def test_goes_on_from_its_state(self, before):
        switch, other = a_switch(), a_switch()
        feed(switch, [(before[0], INSIDE)], steps=before[1])
        other.load_state_dict(switch.state_dict())
        for resumed in (switch, other):
            feed(resumed, [(FAR, INSIDE)], steps=20)
        for name, value in other.state_dict().items():
            torch.testing.assert_close(switch.state_dict()[name], value, equal_nan=True)
        assert (other.factor, other.fraction) == (switch.factor, switch.fraction)


@pytest.mark.parametrize(
    ("time_left_s", "failed", "share", "samples"),
    [
        (0.5, False, 0.5, 1.0),
        (3.0, False, 0.5, 0.0),
        (3.0, True, 0.0, 50.0),  # a crash before the window costs all of its 50 steps
        (0.5, True, 0.0, 25.0),  # and one inside it the rest
    ],
)
def test_the_window_that_a_crash_cut_off_counts_as_zero(time_left_s, failed, share, samples):
    task = a_task(tile_of("flat"), 1, TASK)
    task.command.target_w[:] = torch.tensor([1.0, 0.0, 0.0])
    task.command.time_left_s[:] = time_left_s
    found, weight = task.task_share(a_state(1), torch.tensor([failed]))
    assert float(found) == pytest.approx(share)
    assert float(weight) == pytest.approx(samples)


def test_a_fresh_run_does_not_judge_exploration_by_its_shortened_episodes():
    config = Config(num_envs=16, task=TASK, terrain=TerrainConfig(variants=1))
    env = build_env(config, threads=1)
    in_window = 0
    for _ in range(ExplorationSwitch.CHECK_STEPS - 1):
        in_window += int((env.task.command.time_left_s < 1.0).sum())
        env.step(torch.zeros(16, 12))
    assert in_window > 0
    assert float(env.exploration.state_dict()["sums"][1]) == 0.0


def test_nothing_is_decided_before_the_longest_first_episode_could_have_ended():
    """Robots that stand near their targets and are looked at before they can crash would end the reward at once."""
    switch = ExplorationSwitch(torch.tensor([0]), first_steps=400)
    feed(switch, [(0.0, 0.5)], steps=399)
    assert switch.paid == 1.0
    feed(switch, [(0.0, 0.5)], steps=1)
    assert switch.paid == 0.0
    env = build_env(Config(num_envs=2, task=replace(TASK, episode_s=8.0), terrain=TerrainConfig(variants=1)), threads=1)
    assert ExplorationSwitch.CHECK_STEPS - env.exploration.state_dict()["steps"] == 400


def test_full_episodes_do_count_for_exploration():
    config = Config(num_envs=2, task=TASK, terrain=TerrainConfig(variants=1))
    assignment = (torch.zeros(2, dtype=torch.long), torch.zeros(2, dtype=torch.long))
    env = build_env(config, Placement(assignment=assignment), threads=1)
    env.task.command.time_left_s[:] = torch.tensor([0.5, 3.0])
    for _ in range(20):
        env.step(torch.zeros(2, 12))
    assert float(env.exploration.state_dict()["sums"][1]) == 20.0


@pytest.mark.parametrize("preset", PRESETS)
def test_every_length_of_an_episode_pays_exactly_one_window(preset):
    """Lengths are whole policy steps. The clock counts them down in float32, and slips no step into the window or out.

    Beyond the presets it does: from 8.3 s on, windows of 1 and 2 s have a step more.
    """
    config, dt = get_preset(preset).task, get_preset(preset).physics.control_dt
    lengths = torch.arange(round(config.episode_min_s / dt), round(config.episode_s / dt) + 1)
    count = len(lengths)
    task, state = a_task(tile_of("flat"), count, config), a_state(count)
    begin(task, count)
    # As `new_command` makes them whole.
    task.command.time_left_s[:] = (lengths * dt / dt).round() * dt
    state.base_pos_w = task.command.target_w
    paid, over = torch.zeros(count), torch.zeros(count, dtype=torch.bool)
    for _ in range(int(lengths.max())):
        ended = task.advance(dt)
        paid += dt * bound("task", config)(state, task.command) * ~over
        over |= ended
    assert bool(over.all())
    assert (paid - 1.0).abs().max() < 1e-4


def test_lengths_are_whole_policy_steps():
    task = a_task(tile_of("flat"), 500, replace(TASK, episode_min_s=4.0))
    begin(task, 500)
    steps = task.command.time_left_s / 0.02
    assert (steps - steps.round()).abs().max() < 1e-3
    assert steps.round().unique().numel() > 50
    assert 200 <= int(steps.round().min()) < int(steps.round().max()) <= 300
