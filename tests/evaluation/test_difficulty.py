"""The baselines, the protocol of maximum difficulty on scripted robots, and the report."""

import json
import math
import re
from dataclasses import fields, replace

import pytest
import torch
from PIL import Image
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.cli import main
from arrive.commands import evaluation
from arrive.config import Config, TerrainConfig, override
from arrive.errors import ArriveError
from arrive.evaluation import difficulty
from arrive.evaluation.arrival import Cell, CellResult
from arrive.evaluation.playing import Played, play
from arrive.learning.policy import load_policy
from arrive.presets import PAPER_REWARDS, get_preset
from arrive.report import charts
from arrive.report.diagnosis import why_stuck
from arrive.report.figure import svg_text
from arrive.report.records import Run
from arrive.report.table import LIMITS, PAPER, make_relations
from arrive.task.feet import follow_feet
from arrive.task.registry import TASKS, get_task
from arrive.task.rewards import bound, functions
from arrive.task.state import State
from arrive.task.task import Start, TaskContext
from arrive.task.velocity import VelocityConfig, VelocityTask, air_time, track_speed, yaw_rate
from arrive.terrain import FAMILIES

DT = 0.02
TURNING = (0.5, 1.0)
"""Yaw rate per heading error [1/s] and its limit [rad/s]."""


def configured(task: str, **changes) -> Config:
    """The paper's preset for a task, with few worlds."""
    config = get_preset("paper")
    task = get_task(task).from_preset(config.task)
    return replace(config, **({"terrain": TerrainConfig(variants=1), "num_envs": 1, "task": task} | changes))


def a_state(n: int = 1, **values) -> State:
    """States whose fields are zero unless given; upright."""
    upright = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(n, 4)
    zeros = {field.name: torch.zeros(n, 3) for field in fields(State)}
    return State(**zeros | {"base_quat_w": upright, "foot_contacts": torch.ones(n, 4)} | values)


def velocity_task(n: int = 1, trial=None) -> VelocityTask:
    config = configured("velocity")
    rasters = build_env(config, threads=1).pool.rasters
    task = VelocityTask(config.task, TaskContext(n, DT, rasters, torch.Generator().manual_seed(0)), trial)
    task.new_command(Start(torch.arange(n), torch.zeros(n, 3), torch.zeros(n, dtype=torch.long)), False)
    return task


class TestContinuous:
    def test_the_task_reward_is_paid_at_every_step(self):
        config = configured("continuous")
        env = build_env(config, Placement(assignment=(torch.zeros(1).long(), torch.zeros(1).long())), threads=1)
        task, state = env.task, env.state
        earned, paid = 0.0, 0
        for _ in range(300):
            task.advance(DT)
            state.base_pos_w = task.command.target_w
            rate = float(env.rewarder.terms["task"](state, task.command))
            earned, paid = earned + rate * DT, paid + (rate > 0)
        assert paid == 300
        assert earned == pytest.approx(1.0, abs=1e-5)

    def test_all_other_fields_are_those_of_final(self):
        ours, theirs = configured("continuous").task, configured("final").task
        assert ours.reward_window_s == ours.episode_s
        for field in fields(theirs):
            assert field.name in ("name", "reward_window_s") or getattr(ours, field.name) == getattr(theirs, field.name)

    def test_the_reward_window_cannot_be_set(self):
        with pytest.raises(ArriveError, match="no 'reward_window_s'"):
            override(configured("continuous"), ("task.reward_window_s=1",))


class TestVelocity:
    def test_the_costs_are_the_presets_and_the_episode_is_that_of_legged_gym(self):
        task = configured("velocity").task
        both = functions(task.rewards).keys() & functions(PAPER_REWARDS).keys()
        assert {"joint_acc_cost", "torque_cost", "collision_cost", "action_rate_cost", "foot_acc_cost"} < both
        assert all(getattr(task.rewards, name) == getattr(PAPER_REWARDS, name) for name in both)
        assert (task.episode_s, VelocityTask.bootstraps) == (20.0, True)

    def test_perfect_tracking_earns_in_six_seconds_what_the_paper_pays_for_arriving(self):
        rewards = configured("velocity").task.rewards
        assert 6.0 * (rewards.track_speed.weight + rewards.track_yaw_rate.weight) == pytest.approx(
            PAPER_REWARDS.task.weight
        )

    def test_tracking_by_hand(self):
        task = velocity_task()
        task.command.speed[:], task.command.heading[:] = 0.5, 0.6
        state = a_state(base_lin_vel_b=torch.tensor([[0.2, 0.4, 9.0]]), base_ang_vel_b=torch.tensor([[9.0, 9.0, 0.8]]))
        # Heading error 0.6 asks for 0.3 rad/s. Errors: 0.3^2 + 0.4^2 = 0.25 and 0.5^2 = 0.25.
        assert float(yaw_rate(state, task.command, *TURNING)) == pytest.approx(0.3)
        assert float(track_speed(state, task.command, width=0.25)) == pytest.approx(math.exp(-1.0))
        assert float(bound("track_yaw_rate", VelocityConfig())(state, task.command)) == pytest.approx(math.exp(-1.0))

    def test_the_yaw_rate_turns_the_short_way_and_is_limited(self):
        task = velocity_task()
        task.command.heading[:] = 1.5 * math.pi
        assert float(yaw_rate(a_state(), task.command, *TURNING)) == pytest.approx(-math.pi / 4)
        task.command.heading[:] = 3.0
        assert float(yaw_rate(a_state(), task.command, *TURNING)) == pytest.approx(1.0)

    def test_a_foot_is_paid_on_landing_for_its_time_in_the_air_beyond_half_a_second(self):
        task = velocity_task()
        task.command.speed[:] = 1.0
        in_air_s, touched, paid = torch.zeros(1, 4), torch.ones(1, 4, dtype=torch.bool), []
        for step in range(60):
            # In the air in steps 5 to 44; one step of stance is forgiven when a contact is lost.
            touches = torch.ones(1, 4, dtype=torch.bool)
            touches[0, 2] = not 5 <= step < 45
            in_air_s, landed_s = follow_feet(in_air_s, touched, touches, DT)
            touched = touches
            paid.append(float(air_time(a_state(landed_air_s=landed_s), task.command, least_s=0.5)))
        assert [step for step, value in enumerate(paid) if value] == [45]
        assert paid[45] == pytest.approx(40 * DT - 0.5, abs=1e-5)
        task.command.speed[:] = 0.0
        landed = a_state(landed_air_s=torch.full((1, 4), 0.3))
        assert not air_time(landed, task.command, least_s=0.5).any()

    def test_commands_are_within_range_and_renewed_after_ten_seconds(self):
        task = velocity_task(2000)
        speed = task.command.speed.clone()
        assert float(speed.abs().max()) <= 1.0
        assert float(speed[speed != 0].abs().min()) > 0.2
        assert (speed < 0).any()
        steps = [step for step in range(1, 600) if (task.advance(DT), bool((task.command.speed != speed).any()))[1]]
        assert steps[0] == 500

    @pytest.mark.parametrize(
        ("walked", "speed", "promoted", "demoted"),
        [(4.1, 1.0, True, False), (3.9, 1.0, False, True), (3.9, 0.3, False, False), (2.9, 0.3, False, True)],
    )
    def test_levels_follow_the_distance_walked(self, walked, speed, promoted, demoted):
        task = velocity_task()
        task.command.speed[:] = speed
        none = torch.tensor([False])
        outcome = task.judge(a_state(base_pos_w=torch.tensor([[0.0, walked, 0.5]])), none, none)
        assert (bool(outcome.promote), bool(outcome.demote)) == (promoted, demoted)

    def test_a_robot_at_the_end_of_the_tile_gets_a_time_out(self):
        task = velocity_task()
        task.follow(a_state(base_pos_w=torch.tensor([[0.0, 5.9, 0.5]])))
        assert not task.advance(DT)
        task.follow(a_state(base_pos_w=torch.tensor([[0.0, 6.1, 0.5]])))
        assert task.advance(DT)


def played(task: str, move, family: str = "flat", value: float = 0.0, crash: int | None = None) -> Played:
    """One trial of a scripted robot.

    Args:
        move: time [s] to the position that the robot has then.
        crash: the step in which it touches the ground with its body.
    """
    config = replace(configured(task), randomisation=difficulty.randomised(Config().randomisation), num_envs=1)
    config = replace(config, terrain=replace(config.terrain, families=(family,)))
    nowhere = (torch.zeros(1).long(), torch.zeros(1).long())
    placement = Placement("evaluation", ((value,),), 7, difficulty.TRIAL, nowhere)
    env = build_env(config, placement, threads=1)
    read, start = env.physics.read, env.state.base_pos_w.clone()
    clock = {"step": 0}

    def scripted(env_ids=None):
        readings = read(env_ids)
        position = torch.tensor([move(clock["step"] * DT, env.task)]) if clock["step"] else start
        contacts = torch.full((1,), float(clock["step"] == crash))
        return replace(readings, base_pos_w=position.float(), crash_contacts=contacts)

    class Still:
        def act(self, observation: Tensor) -> Tensor:
            clock["step"] += 1
            return torch.zeros(1, 12)

    env.physics.read = scripted
    return play(env, Still(), torch.tensor([], dtype=torch.long))


def near_target(distance: float):
    def move(time_s: float, task) -> list[float]:
        x, y, z = task.destination_w[0].tolist()
        return [x - distance, y, z]

    return move


def forward(speed: float):
    return lambda time_s, task: [speed * time_s, 0.0, 0.6]


class TestProtocol:
    def test_a_robot_put_at_the_target_succeeds_and_needs_the_whole_time(self):
        for task in ("final", "continuous"):
            result = played(task, near_target(0.0))
            assert bool(result.success)
            assert int(result.steps) == 400
            assert int(result.reached) == 1

    def test_the_target_is_five_metres_ahead(self):
        assert played("final", near_target(0.0), "pit", 0.5).target_w[0].tolist() == pytest.approx([5.0, 0.0, 1.0])

    @pytest.mark.parametrize(("distance", "success"), [(0.49, True), (0.51, False)])
    def test_success_is_being_within_half_a_metre(self, distance, success):
        result = played("final", near_target(distance))
        assert bool(result.success) == success
        assert float(result.distance) == pytest.approx(distance, abs=1e-5)

    def test_a_crash_in_the_last_step_is_a_failure_in_position_tasks(self):
        result = played("final", near_target(0.0), crash=400)
        assert not bool(result.success)
        assert result.cause == ["crash"]

    def test_a_velocity_trial_succeeds_if_the_robot_crashes_after_four_metres(self):
        assert bool(played("velocity", forward(0.8), crash=300).success)
        early = played("velocity", forward(0.8), crash=200)
        assert not bool(early.success)
        assert early.cause == ["crash"]

    def test_velocity_must_walk_more_than_four_metres_along_the_terrain(self):
        assert bool(played("velocity", forward(0.53)).success)
        assert not bool(played("velocity", forward(0.47)).success)
        assert not bool(played("velocity", lambda t, task: [0.0, 0.7 * t, 0.6]).success)

    def test_a_robot_before_the_wall_is_on_the_wrong_side_and_one_that_never_left_stalled(self):
        waits = played("final", lambda t, task: [min(t, 1.3), 0.0, 0.6], "pit", 0.8)
        assert waits.cause == ["wrong_side"]
        assert played("final", lambda t, task: [0.0, 0.0, 0.6], "pit", 0.8).cause != ["wrong_side"]

    def test_a_robot_in_front_of_a_pillar_is_on_the_wrong_side(self):
        blocked = played("final", lambda t, task: [min(t, 1.0), 0.0, 0.6], "obstacles", 0.8)
        assert blocked.cause == ["wrong_side"]

    def test_a_robot_that_got_around_the_pillar_is_not_on_the_wrong_side(self):
        around = played("final", lambda t, task: [min(0.6 * t, 4.25), min(0.2 * t, 1.25), 0.6], "obstacles", 0.2)
        assert around.cause == ["stalled"]

    def test_the_velocity_trial_commands_one_metre_per_second_forward(self):
        task = velocity_task(3, difficulty.TRIAL)
        assert task.command.speed.tolist() == [1.0] * 3
        assert task.episode_s == 8.0
        for _ in range(399):
            assert not task.advance(DT).any()
        assert task.advance(DT).all()


def results(*arrived: int, episodes: int = 100, **failures: int) -> list[CellResult]:
    gap = FAMILIES["gap"]
    return [CellResult(Cell(gap, i, 0.1 * (i + 1)), episodes, n, 0.0, failures) for i, n in enumerate(arrived)]


class TestMaximum:
    @pytest.mark.parametrize(
        ("arrived", "at_95", "at_80"),
        [((100, 95, 94), 0.2, 0.3), ((94, 100, 100), None, 0.3), ((100, 79, 100), 0.1, 0.1), ((0, 0, 0), None, None)],
    )
    def test_all_levels_below_the_maximum_are_solved_too(self, arrived, at_95, at_80):
        assert difficulty.max_at(results(*arrived), 0.95) == pytest.approx(at_95)
        assert difficulty.max_at(results(*arrived), 0.80) == pytest.approx(at_80)

    def test_a_success_rate_is_printed_with_its_interval(self):
        (result,) = results(979, episodes=1000)
        assert result.rate == "97.9% of 1000 (96.8% to 98.6%)"

    def test_475_of_500_is_95_percent(self):
        assert difficulty.max_at(results(475, 474, episodes=500), 0.95) == pytest.approx(0.1)

    def test_the_levels_reach_beyond_the_paper(self):
        for family, row in PAPER.items():
            values = [cell.value for cell in difficulty.difficulty_cells(FAMILIES[family], None)]
            assert values == sorted(values)
            assert values[-1] > row["final"]
            assert values[-1] <= FAMILIES[family].highest + 1e-9

    def test_the_summary_says_how_far_and_why_not_further(self):
        sentence = why_stuck(results(99, 63, 0, fell=30, crash=7))
        assert (
            sentence == "gap: at least 95% up to 0.1 m; at 0.2 m 63.0% succeed, 30.0% fell into the hole, 7.0% crashed"
        )
        assert why_stuck(results(99, 98)) == "gap: at least 95% at every level up to 0.2 m"

    def test_relations_fall_back_on_looser_limits(self):
        def entry(task, *values):
            return {"task": task, "max_at_95": values[0], "max_at_80": values[1], "max_at_50": values[2]}

        def verdict(*entries):
            row = {"family": "gap", "unit": "m", "ours": list(entries)}
            (relation,) = (r for r in make_relations([row]) if r["families"])
            assert relation["verdict"] == relation["families"]["gap"]["verdict"]
            return relation["verdict"]

        assert verdict(entry("final", 0.4, 0.4, 0.4), entry("velocity", None, 0.9, 0.9)) == "holds"
        assert verdict(entry("final", None, 0.4, 0.5), entry("velocity", None, 0.4, 0.6)) == "fails"
        assert verdict(entry("final", None, None, None), entry("velocity", None, None, None)) == "open"
        same = (0.4, 0.4, 0.4)
        assert verdict(entry("final", *same), entry("continuous", *same)) == "fails"

    def test_the_papers_own_table_passes_its_claims(self):
        relations = make_relations(table_of(PAPER))
        assert {r["claim"]: r["verdict"] for r in relations} == {
            "P_f above V on every terrain": "holds",
            "P_c above V on at least half of the terrains": "holds",
            "P_f above P_c on every terrain": "holds",
        }
        above = relations[1]["families"]
        assert [name for name, found in above.items() if found["verdict"] == "holds"] == ["steps", "gap", "pit"]

    def test_one_terrain_less_than_the_paper_has_fails_a_claim(self):
        assert overall(PAPER | {"gap": {"velocity": 0.7, "continuous": 0.65, "final": 1.2}})[1] == "fails"
        assert overall(PAPER | {"pit": {"velocity": 0.1, "continuous": 0.95, "final": 0.95}})[2] == "fails"
        nothing = {"velocity": None, "continuous": None, "final": None}
        assert overall(PAPER | {"gap": nothing}) == ["open", "open", "open"]
        assert [relation["verdict"] for relation in make_relations([])] == ["open", "open", "open"]


def table_of(results: dict) -> list[dict]:
    """Rows as of `make_table`, of one run per task."""
    return [
        {
            "family": family,
            "unit": FAMILIES[family].unit,
            "ours": [{"task": task} | dict.fromkeys(LIMITS, value) for task, value in values.items()],
        }
        for family, values in results.items()
    ]


def overall(results: dict) -> list[str]:
    return [relation["verdict"] for relation in make_relations(table_of(results))]


@pytest.fixture(autouse=True, scope="module")
def few_worlds():
    """Compiling worlds would take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(difficulty, "VARIANTS", 2)
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A tiny run of every task."""
    folder = tmp_path_factory.mktemp("runs")
    for task in TASKS:
        arguments = f"train flat,gap --task {task} --num-envs 16 --iterations 2 --threads 1 --set terrain.variants=1"
        main([*arguments.split(), "ppo.hidden=[16]", "ppo.num_steps=8", "--out", str(folder / task)])
    return folder


def measured(run, **changes) -> dict:
    options = {"episodes": 8, "seed": 1, "levels": 2, "threads": 1} | changes
    return difficulty.measure_difficulty(load_policy(run), [FAMILIES["gap"]], **options).content


class TestMeasurement:
    def test_is_identical_when_repeated_and_at_any_number_of_threads(self, runs):
        first = measured(runs / "final")
        assert json.dumps(first) == json.dumps(measured(runs / "final", threads=2))

    def test_the_result_has_the_documented_keys(self, runs):
        content = json.loads(json.dumps(measured(runs / "velocity")))
        assert set(content) == {"families", "policy", "protocol", "commit"}
        gap = content["families"]["gap"]
        assert set(gap) == {"parameter", "unit", "levels", "max_at_95", "max_at_80", "max_at_50"}
        assert (gap["parameter"], gap["unit"], gap["max_at_95"]) == ("width", "m", None)
        assert [level["value"] for level in gap["levels"]] == pytest.approx([0.02, 1.4])
        for level in gap["levels"]:
            assert set(level) == {"value", "episodes", "success", "interval", "failures"}
            assert level["interval"][0] <= level["success"] <= level["interval"][1]
            assert sum(level["failures"].values()) == level["episodes"] - round(level["success"] * level["episodes"])

    def test_seeds_give_different_results_with_overlapping_intervals(self, runs):
        first, second = (measured(runs / "final", seed=seed, episodes=12, levels=1) for seed in (1, 2))
        assert first != second
        (low, high), (other_low, other_high) = (c["families"]["gap"]["levels"][0]["interval"] for c in (first, second))
        assert low <= other_high
        assert other_low <= high

    def test_progress_ends_at_its_total(self, runs):
        seen = []
        difficulty.measure_difficulty(
            load_policy(runs / "final"), [FAMILIES["flat"]], 4, 1, None, 1, lambda i, n: seen.append((i, n))
        )
        assert seen == sorted(seen)
        assert seen[-1][0] <= seen[-1][1]


@pytest.fixture(scope="module")
def page(runs):
    """A report of three runs, two of them measured; pictures and films, tested elsewhere, are blank."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "film", lambda episode, path: path.touch())
        patch.setattr(evaluation, "picture_strip", lambda episode, path: Image.new("RGB", (8, 8)).save(path))
        for task in ("final", "velocity"):
            arguments = "--protocol difficulty --terrain gap --episodes 4 --levels 2 --threads 1"
            main(["eval", str(runs / task), *arguments.split()])
    out = runs / "report.html"
    main(["report", *(str(runs / task) for task in TASKS), "--out", str(out)])
    return out


class TestReport:
    def test_the_page_loads_nothing_from_elsewhere(self, page):
        text = page.read_text()
        assert "http" not in text
        assert "<script" not in text
        assert all(source.startswith("data:") for source in re.findall(r'src="([^"]*)"', text))
        assert "url(" not in text
        assert text.count('src="data:image/jpeg') == 2

    def test_has_the_table_with_the_papers_figures_and_ours(self, page):
        text, content = page.read_text(), json.loads(page.with_suffix(".json").read_text())
        for figure in ("0.22 m", "48 deg", "1.2 m", "8 episodes", "not measured"):
            assert figure in text
        gap = next(row for row in content["table"] if row["family"] == "gap")
        assert gap["paper"] == {"velocity": 0.15, "continuous": 0.65, "final": 1.2}
        assert {entry["task"] for entry in gap["ours"]} == {"final", "velocity"}
        assert [entry["episodes"] for entry in gap["ours"]] == [8, 8]

    def test_every_run_is_listed_with_its_command(self, page):
        content = json.loads(page.with_suffix(".json").read_text())
        assert [run["name"] for run in content["runs"]] == list(TASKS)
        assert content["runs"][0]["eval_command"].startswith("arrive eval --protocol difficulty final --terrain gap")
        assert all(run["commit"] and run["train_command"] for run in content["runs"])

    def test_a_file_beside_the_page_that_no_report_wrote_is_not_replaced_without_force(self, runs, tmp_path, capsys):
        arguments = ["report", str(runs / "final"), "--out", str(tmp_path / "energy.html")]
        other = tmp_path / "energy.json"
        other.write_text('{"protocol": {"name": "energy"}}')
        with pytest.raises(SystemExit):
            main(arguments)
        assert f"{other} holds something else than a result of this command; give --force" in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ["energy.json"]
        main([*arguments, "--force"])
        main(arguments)
        assert [run["name"] for run in json.loads(other.read_text())["runs"]] == ["final"]

    def test_a_folder_without_a_run_is_an_error(self, tmp_path, capsys):
        with pytest.raises(SystemExit):
            main(["report", str(tmp_path)])
        assert "not a run folder" in capsys.readouterr().err


def test_seven_runs_of_one_task_have_different_colours():
    """As many as the shipped policies: a generalist and a specialist for each of six terrains."""
    log = {"progress/samples": [1e6, 2e6], "arrival/all": [0.1, 0.2]}
    record = {"config": {"task": {"name": "final"}}}
    svg = svg_text(charts.training_chart([Run(str(i), record, log, None, {}) for i in range(7)]))
    lines = [style for style in re.findall(r'style="([^"]*)"', svg) if "stroke-width: 1.5" in style]
    assert len(set(lines)) >= 7


def test_an_inactive_robot_neither_moves_nor_ends_again():
    """Its contacts are those of its last step, for instance a crash, which must not count in every later one."""
    two = torch.zeros(2, dtype=torch.long)
    env = build_env(configured("final", num_envs=2), Placement(assignment=(two, two)), threads=1)
    read = env.physics.read
    crashes = torch.tensor([1.0, 0.0])
    env.physics.read = lambda env_ids=None: replace(
        read(env_ids), crash_contacts=crashes if env_ids is None else crashes[env_ids]
    )
    env.step(torch.zeros(2, 12))
    assert env.log.finished.env_ids.tolist() == [0]
    env.deactivate(torch.tensor([0]))
    before = env.state.base_pos_w.clone()
    for _ in range(5):
        env.step(torch.zeros(2, 12))
        assert env.log.finished is None
    moved = (env.state.base_pos_w != before).any(-1)
    assert moved.tolist() == [False, True]
