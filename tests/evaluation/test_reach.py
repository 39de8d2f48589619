"""Success by distance, direction and time, waiting at the target, and results that shorter ones do not replace."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

import small_results
from arrive.build import build_env
from arrive.cli import main
from arrive.commands import evaluation
from arrive.commands.policies import read_policy
from arrive.commands.results import effort_of, keep_longer
from arrive.config import Config, override
from arrive.deployment import goals
from arrive.errors import ArriveError
from arrive.evaluation import arrival, reach
from arrive.evaluation.arrival import Arrival, Cell, choose_cells, evaluate
from arrive.evaluation.difficulty import TRIAL, max_at, randomised
from arrive.evaluation.reach import ReachGrid
from arrive.learning.policy import Policy
from arrive.play.skills import open_skill
from arrive.policies import SHIPPED
from arrive.policies.solved import solved_beside
from arrive.presets import get_preset
from arrive.report.card import write_card
from arrive.report.reach import direction_table, distance_table, protocol_words, waiting_words
from arrive.report.records import Run, read_run
from arrive.task.final import FinalConfig, FinalPositionTask
from arrive.task.targets import next_valid
from arrive.task.task import Start, TaskContext
from arrive.task.velocity import VelocityConfig
from arrive.terrain import FAMILIES, get_family
from arrive.terrain.ground import Ground, ground_of
from arrive.terrain.rasters import stack_rasters

DT = 0.02
CONFIG = override(get_preset("paper"), ("num_envs=4", "terrain.levels=3", "terrain.variants=1"))
SHORT = ReachGrid((0.5, 2.0), (0.0, 90.0), (0.4, 0.8))


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Few worlds and a short wait."""
    monkeypatch.setattr(reach, "VARIANTS", 1)
    monkeypatch.setattr(reach, "WAIT_S", 0.4)


def standing(config: Config = CONFIG) -> Policy:
    """A policy that holds the default pose."""
    schema = build_env(config, threads=1).observer.schema()
    return Policy(
        Path("runs/still/policy.pt"), config, schema, "none", 0, lambda seen: torch.zeros(len(seen["policy"]), 12)
    )


class TestTargets:
    def test_a_place_that_is_valid_stays_and_one_in_the_hole_moves_straight_on(self):
        rasters = stack_rasters([ground_of("gap=0.4", layout="evaluation").build()])
        points = torch.tensor([[0.5, 0.0], [1.6, 0.0], [1.6, 0.8], [-3.0, 0.0]])
        found = next_valid(rasters, torch.zeros(4, dtype=torch.long), points)
        assert torch.equal(found[[0, 3]], points[[0, 3]])
        # The far edge is at 1.9 m, and targets keep 0.35 m from the gap; cells are 0.05 m.
        assert found[1].tolist() == pytest.approx([2.25, 0.0], abs=0.1)
        assert float(found[2, 1] / found[2, 0]) == pytest.approx(0.5)
        assert float(found[2, 0]) == pytest.approx(2.25, abs=0.1)

    def test_where_nothing_behind_is_valid_the_next_place_before_it_is_taken(self):
        rasters = stack_rasters([ground_of("flat").build()])
        (found,) = next_valid(rasters, torch.zeros(1, dtype=torch.long), torch.tensor([[9.0, 0.0]])).tolist()
        assert found == pytest.approx([6.5, 0.0], abs=0.06)

    def test_each_robot_gets_the_target_of_its_cell(self):
        cells = [Cell(get_family("flat"), None, 0.0, target) for target in ((1.0, 0.0), (0.0, -2.0))]
        setting = arrival.Conditions("evaluation", replace(TRIAL, duration_s=0.1), randomised, 1, record=False)
        answer = evaluate(standing(), cells, 3, 1, 1, setting=setting)
        targets = torch.cat([part.target_w for part in answer.played])[:, :2]
        assert targets.tolist() == [[1.0, 0.0]] * 3 + [[0.0, -2.0]] * 3
        assert answer.episodes == []


def waiting_task(n: int = 1) -> FinalPositionTask:
    trial = replace(TRIAL, duration_s=1.0, wait_s=2.0, hold_s=0.7)
    rasters = stack_rasters([ground_of("flat").build()])
    task = FinalPositionTask(FinalConfig(), TaskContext(n, DT, rasters, torch.Generator().manual_seed(0)), trial)
    task.new_command(Start(torch.arange(n), torch.zeros(n, 3), torch.zeros(n, dtype=torch.long)), False)
    return task


class TestWaiting:
    def test_the_time_runs_out_then_stays_at_the_hold_time_and_then_the_episode_ends(self):
        task = waiting_task()
        assert task.episode_s == 3.0
        told = []
        for _ in range(149):
            assert not bool(task.advance(DT))
            told.append(float(task.command.time_left_s))
        assert told[:49] == pytest.approx([1.0 - DT * i for i in range(1, 50)], abs=1e-4)
        assert told[49:] == pytest.approx([0.7] * 100)
        assert bool(task.advance(DT))

    def test_the_policy_observes_the_same_time_left_as_from_the_controller(self):
        for window, episode in ((2.0, 8.0), (6.0, 6.0)):
            task = FinalConfig(reward_window_s=window, episode_s=episode, episode_min_s=episode)
            spec = SimpleNamespace(reward_window_s=window, episode_s=episode)
            assert reach.hold_time(task) == goals.hold_time(spec)

    def test_waiting_counts_robots_that_arrived_and_neither_left_nor_crashed(self):
        """Five robots: stays, leaves, crashes in the wait, comes too late, crashed before."""
        distance = torch.tensor([[0.1, 0.1, 0.1, 0.9, 0.1], [0.1, 0.9, 0.1, 0.1, 0.1]])
        trace = torch.zeros(3, 5, 3)
        trace[1:, :, 0] = distance
        played = SimpleNamespace(
            trace_w=trace,
            target_w=torch.zeros(5, 3),
            steps=torch.tensor([2, 2, 2, 2, 1]),
            success=torch.tensor([True, False, False, True, False]),
            cause=["", "stalled", "crash", "", "crash"],
        )
        answer = Arrival([], torch.zeros(5).long(), [played], [])
        waiting = reach._waiting(answer, 0.5, DT, DT)
        assert (waiting["arrived"], waiting["stayed"]) == (3, 1)
        assert waiting["failures"] == {"crash": 1, "stalled": 1}
        assert "1 of 3 robots" in waiting_words(waiting)
        nobody = reach._waiting(answer, 0.01, DT, DT)
        assert nobody["share"] is None
        assert "nobody arrived" in waiting_words(nobody)


class TestMeasurement:
    def test_robots_that_stand_arrive_where_the_target_is_near_and_wait_there(self):
        config = override(CONFIG, ("task.arrival_radius=1",))
        told = []
        content = reach.measure_reach(
            standing(config), [Ground(get_family("flat"), 0.0)], SHORT, 4, 1, 1, lambda *counts: told.append(counts)
        )
        assert content == json.loads(json.dumps(content))
        flat = content["families"]["flat"]
        assert [(row["distance_m"], row["time_s"]) for row in flat["distances"]] == [
            (0.5, 0.4), (2.0, 0.4), (0.5, 0.8), (2.0, 0.8),
        ]  # fmt: skip
        assert [row["success"] for row in flat["distances"]] == [1.0, 0.0, 1.0, 0.0]
        assert [(row["direction_deg"], row["success"]) for row in flat["directions"]] == [(0.0, 0.5), (90.0, 0.5)]
        assert (flat["waiting"]["arrived"], flat["waiting"]["stayed"]) == (2, 2)
        # 2 distances x 2 times x 4, 2 directions x 2 distances x 2, and 2 x 2 that wait.
        assert content["protocol"]["effort"] == effort_of(content) == 28
        assert told == sorted(told)
        assert told[-1][0] == told[-1][1]

    def test_a_target_in_the_hole_is_reported(self):
        content = reach.measure_reach(
            standing(), [ground_of("gap=0.4")], ReachGrid((1.6, 4.0), (0.0,), (0.1,)), 1, 1, 1
        )
        entry = content["families"]["gap"]
        assert [row.get("stood_at_m") for row in entry["distances"]] == [pytest.approx(2.25, abs=0.1), None]
        head, rows = distance_table(entry)
        assert head[:2] == ["distance", "in 0.1 s [%]"]
        assert "next valid place: 2." in rows[0][0]
        assert rows[1][:2] == ["4 m", "0.0 (0.0-79.3)"]
        assert direction_table(entry)[1][0][0] == "0°"

    def test_a_policy_that_follows_a_velocity_is_refused(self):
        policy = replace(standing(), config=replace(CONFIG, task=VelocityConfig()))
        with pytest.raises(ArriveError, match=r"'velocity' has no targets.*difficulty"):
            reach.check_policy(policy)

    @pytest.mark.parametrize(
        ("grid", "words"),
        [
            (ReachGrid(distances=(0.0,)), "--target-distance must be numbers from 0.1 to 6.4 m"),
            (ReachGrid(distances=(1.0, 7.0)), "not 1,7"),
            (ReachGrid(directions=(400.0,)), "--direction must be"),
            (ReachGrid(times=(float("nan"),)), "--time must be"),
            (ReachGrid(times=(3.0, 3.0)), "--time names a value twice"),
        ],
    )
    def test_grids_that_cannot_be_run_are_refused(self, grid, words):
        with pytest.raises(ArriveError, match=words):
            grid.check()

    def test_the_ground_is_the_hardest_solved_or_a_middle_one(self, tmp_path):
        gap = get_family("gap")
        middle = pytest.approx((gap.lowest + gap.highest) / 2)
        assert reach.hardest_solved(solved_beside(tmp_path), gap, 3) == middle
        (tmp_path / "difficulty.json").write_text(json.dumps(small_results.difficulty()))
        assert reach.hardest_solved(solved_beside(tmp_path), gap, 3) == 0.3
        (tmp_path / "difficulty.json").write_text("{}")
        with pytest.raises(ArriveError, match=r"difficulty.json holds no result of 'difficulty'"):
            solved_beside(tmp_path)


class TestChoosing:
    def test_a_level_is_one_of_the_policys_own_and_a_value_is_physical(self):
        gap, pit = FAMILIES["gap"], FAMILIES["pit"]
        middle = (pit.lowest + pit.highest) / 2
        assert choose_cells(CONFIG, "gap=0.4,pit") == [(gap, Cell(gap, None, 0.4)), (pit, None)]
        assert choose_cells(CONFIG, "pit", level=1) == [(pit, Cell(pit, 1, pytest.approx(middle)))]
        assert choose_cells(CONFIG, "gap", value=0.25) == [(gap, Cell(gap, None, 0.25))]
        assert [family.name for family, _ in choose_cells(CONFIG, "all")] == list(FAMILIES)
        assert choose_cells(CONFIG, None) == [(FAMILIES["flat"], None)]

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("gap=9",), "the width of gap is 0.02 to 1.4 m, not 9"),
            (("gap=0.4", 1), "a level or a value, not both"),
            (("gap,pit", None, 0.4), "--value is of one terrain"),
            (("gap=0.4", None, 0.4), "--value is of one terrain"),
            (("flat", None, 0.4), "flat has no parameter"),
            (("gaps=0.4",), "unknown terrain"),
            (("gap", 3), "level 3 of gap is out of range: levels are 0 to 2"),
        ],
    )
    def test_options_that_do_not_fit_together_are_refused(self, arguments, words):
        with pytest.raises(ArriveError, match=words):
            choose_cells(CONFIG, *arguments)


def test_a_shorter_result_does_not_replace_a_longer_one(tmp_path):
    path = tmp_path / "result.json"
    keep_longer(path, "difficulty", 1, force=False)
    levels = [{"episodes": 60}, {"episodes": 40}]
    path.write_text(json.dumps({"families": {"gap": {"levels": levels}}, "protocol": {"name": "difficulty"}}))
    for effort in (100, 500):
        keep_longer(path, "difficulty", effort, force=False)
    with pytest.raises(ArriveError, match=r"longer measurement \(100 against 99 .*--force"):
        keep_longer(path, "difficulty", 99, force=False)
    keep_longer(path, "difficulty", 99, force=True)
    with pytest.raises(ArriveError, match=r"result.json holds something else than a result of this command"):
        keep_longer(path, "reach", 500, force=False)


def test_a_result_does_not_replace_a_run_s_configuration(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"config": {}, "seed": 1}))
    with pytest.raises(ArriveError, match=r"config.json holds something else than a result"):
        keep_longer(tmp_path / "config.json", "reach", 500, force=False)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of one iteration."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    arguments = (
        "train gap --num-envs 8 --iterations 1 --threads 1 --set terrain.variants=1 ppo.hidden=[8] ppo.num_steps=4"
    )
    main([*arguments.split(), "terrain.levels=2", "--out", str(folder)])
    return folder


def refused(capsys, *arguments: object) -> str:
    with pytest.raises(SystemExit):
        main([str(argument) for argument in arguments])
    return capsys.readouterr().err


REACH = "--target-distance 1 --direction 0 --time 0.5 --threads 1"


def test_the_command_writes_result_and_card_and_keeps_the_longer_result(trained, capsys):
    main(["eval", str(trained), *REACH.split(), "--terrain", "gap=0.4", "--episodes", "3"])
    out = capsys.readouterr().out
    assert "gap 0.4 m" in out
    content = json.loads((trained / "reach.json").read_text())
    assert content["families"]["gap"]["value"] == 0.4
    assert content["protocol"]["effort"] == 9
    card = (trained / "card.md").read_text()
    assert "## Where and by when it arrives" in card
    assert "### gap 0.4 m" in card
    assert "| 1 m " in card
    assert "What it solves" not in card
    assert read_run(trained).reach == content
    shorter = ["eval", trained, *REACH.split(), "--value", "0.4", "--episodes", "2"]
    assert "--force" in refused(capsys, *shorter)
    assert json.loads((trained / "reach.json").read_text()) == content
    main([*map(str, shorter), "--force"])
    assert json.loads((trained / "reach.json").read_text())["protocol"]["effort"] == 6


def test_the_result_of_an_exported_file_goes_to_a_folder_of_its_name(exported, tmp_path):
    file = tmp_path / "robot.onnx"
    shutil.copy(exported, file)
    journey = "--target-distance 0.5 --direction 0 --time 0.5 --terrain flat --episodes 1 --threads 1"
    main(["eval", str(file), "--protocol", "reach", *journey.split()])
    assert (tmp_path / "robot" / "reach.json").is_file()
    assert not (tmp_path / "reach.json").exists()


def test_an_exported_file_solves_what_was_measured_of_it_or_else_of_its_run(exported, tmp_path):
    """Wherever the value is used: `reach`, `play` and the report."""
    file = tmp_path / "robot.onnx"
    shutil.copytree(SHIPPED / "gap", tmp_path / "gap")
    main(["export", str(tmp_path / "gap"), "-o", str(file)])
    inside = solved_beside(SHIPPED / "gap")["gap"]

    def used() -> tuple[float, ...]:
        report = read_run(file).results()["gap"]
        return evaluation._solved(read_policy(file))["gap"], open_skill(str(file)).solved["gap"], max_at(report, 0.95)

    assert used() == (inside,) * 3
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "difficulty.json").write_text(json.dumps(small_results.difficulty()))
    assert used() == (0.3,) * 3
    (tmp_path / "difficulty.json").write_text("of something else")
    assert used() == (0.3,) * 3


def test_a_measurement_of_one_value_does_not_replace_the_whole_protocol(trained, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("arrive.commands.evaluation._write_pictures", lambda *args, **options: None)
    command = ["eval", str(trained), "--protocol", "difficulty", "--episodes", "2", "--threads", "1", "--value", "0.3"]
    monkeypatch.setattr(arrival, "MAX_ENVS", 8)
    main([*command, "--json", str(tmp_path / "one.json")])
    (level,) = json.loads((tmp_path / "one.json").read_text())["families"]["gap"]["levels"]
    assert (level["value"], level["episodes"]) == (0.3, 2)
    assert not (trained / "difficulty.json").exists()
    assert "leave it out to measure one" in refused(capsys, *command, "--levels", "3")
    assert "evaluation layout" in refused(capsys, *command, "--layout", "training")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--time 3,x", "--time must be numbers joined by commas, such as 1,2.5, not '3,x'"),
        ("--time 3 --protocol arrival", "--time needs --protocol reach, not arrival"),
        ("--direction 0 --protocol difficulty", "--direction needs --protocol reach, not difficulty"),
        ("--levels 3 --protocol reach", "--levels is not for --protocol reach"),
        ("--protocol reach --episodes 0", "episodes must be at least 1"),
    ],
)
def test_options_that_do_not_go_together_are_refused(trained, capsys, options, words):
    assert words in refused(capsys, "eval", trained, "--threads", "1", *options.split())


def test_the_card_compares_with_the_protocol_at_the_same_value():
    entry = {"value": 0.4}
    level = {"value": 0.4, "success": 0.9, "interval": [0.8, 0.95]}
    trial = {"target": [4.5, 0.0], "duration_s": 7.0}
    difficulty = {"families": {"gap": {"levels": [{"value": 0.3}, level]}}, "protocol": {"trial": trial}}
    assert "(4.5 m ahead, 7 s): 90.0 (80.0-95.0) %" in protocol_words(difficulty, "gap", entry)
    assert protocol_words(difficulty, "gap", {"value": 0.35}) == ""
    assert protocol_words(None, "gap", entry) == ""


def test_a_run_without_any_measurement_has_no_card():
    with pytest.raises(ArriveError, match="was not measured"):
        write_card(Run("name", {}, {}, None, {}), Path("nowhere"))
