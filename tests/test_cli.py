"""The command line: what it refuses and why, and one run from training to pictures."""

import contextlib
import csv
import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import imageio.v2 as imageio
import pytest
import torch
from PIL import Image

from arrive import cli
from arrive.commands import evaluation, names
from arrive.commands.options import Eval
from arrive.errors import shown
from arrive.fields import rows
from arrive.learning.rundir import commit, write_config
from arrive.policies import SHIPPED, shipped_names
from arrive.policies.solved import amounts, solved_beside
from arrive.presets import PRESETS
from arrive.recipe import make_config
from arrive.render import graphics, pictures
from arrive.robots import ROBOTS
from arrive.task.registry import TASKS
from arrive.task.rewards import PositionRewards, functions
from arrive.terrain import FAMILIES, parse_families
from settings import SMALL

REWARDS = functions(PositionRewards())
TINY = ["--num-envs", "16", "--threads", "1", "--set", *SMALL, "terrain.variants=1"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Run in an empty folder: a command may write to ./runs."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@pytest.fixture
def refused(capsys):
    """Run a command that must end with status 1 and one line on standard error; returns that line."""

    def run(*arguments: object) -> str:
        with pytest.raises(SystemExit) as stopped:
            cli.main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert stopped.value.code == 1, err
        assert err.startswith("arrive: ")
        assert err.count("\n") == 1, "one line, no traceback"
        assert "Traceback" not in out
        return err

    return run


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a run of 3 iterations on flat ground."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    cli.main(["train", "flat", "--iterations", "3", "--out", str(folder), "--seed", "7", *TINY])
    return folder


@pytest.mark.parametrize(
    ("arguments", "valid"),
    [
        (["train", "flt"], FAMILIES),
        (["train", "pit,gapp"], FAMILIES),
        (["train", "flat", "--preset", "robst"], PRESETS),
        (["train", "flat", "--task", "fnal"], TASKS),
        (["train", "flat", "--set", "ppo.gama=1"], ["gamma", "lam", "clip"]),
        (["train", "flat", "--robot", "cat"], ROBOTS),
        (["train", "flat", "--set", "task.rewards.tasks=1"], REWARDS),
        (["train", "flat", "--set", "physics.motor=steam"], ["dc", "ideal"]),
        (["list", "terrain"], ["terrains", "presets", "robots", "tasks", "rewards"]),
    ],
)
def test_an_unknown_name_lists_the_valid_ones(refused, arguments, valid):
    message = refused(*arguments)
    assert "unknown" in message
    missing = [name for name in valid if name not in message]
    assert missing == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "flat,"], ["empty terrain name", "all"]),
        (["train", "pit,gap,pit"], ["pit is listed more than once"]),
        (["train", "flat", "--num-envs", "0"], ["--num-envs must be at least 1, not 0"]),
        (["train", "flat", "--num-envs", "-3"], ["--num-envs must be at least 1, not -3"]),
        (["train", "flat", "--set", "num_envs=0"], ["num_envs must be at least 1, not 0"]),
        (["train", "all", "--num-envs", "3"], ["num_envs must be", f"terrain families, {len(FAMILIES)}, not 3"]),
        (["train", "flat", "--minutes", "0"], ["--minutes must be above 0, not 0"]),
        (["train", "flat", "--minutes", "-1.5"], ["--minutes must be above 0, not -1.5"]),
        (["train", "flat", "--iterations", "0"], ["--iterations must be at least 1, not 0"]),
        (["train", "flat", "--iterations", "-2"], ["--iterations must be at least 1, not -2"]),
        (["train", "flat", "--set", "ppo.gamma"], ["PATH=VALUE"]),
        (["train", "flat", "--set", "ppo.gamma=high"], ["ppo.gamma", "float"]),
        (["train", "flat", "--set", "terrain.levels=0"], ["terrain.levels", "at least 1"]),
        (["train", "flat", "--resume", "."], [".", "not a run folder", "config.json"]),
        (["train", "flat", "--resume", "no/such/folder"], ["no/such/folder", "not a run folder"]),
        (["train", "flat", "--num-envs", "4", "--start-from", "nowhere"], ["there is no policy 'nowhere'"]),
        (["eval", "nowhere"], ["there is no policy 'nowhere'", ", ".join(shipped_names())]),
        (["eval", "."], ["no file", "policy.pt"]),
    ],
)
def test_impossible_commands_are_refused_with_a_reason(refused, arguments, words):
    message = refused(*arguments)
    for word in words:
        assert word in message


@pytest.mark.parametrize("arguments", [["train"], ["eval"], ["fly"], ["train", "flat", "--iterations", "many"]])
def test_an_incomplete_command_is_a_usage_error(capsys, arguments):
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    assert stopped.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("trian flat", "unknown command 'trian'. Did you mean 'train'? Valid: actuator, bench, drive"),
        (
            "actuator fitt log.npz",
            "unknown actuator command 'fitt'. Did you mean 'fit'? Valid: fit, import, record, show",
        ),
        ("xyz", "unknown command 'xyz'. Valid: actuator, bench"),
    ],
)
def test_a_misspelt_command_is_one_line_with_a_suggestion(capsys, words, said):
    with pytest.raises(SystemExit) as stopped:
        cli.main(words.split())
    err = capsys.readouterr().err
    assert stopped.value.code == 2
    assert err.startswith(f"arrive: {said}")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("eval gap --episodes 0.5", "'0.5' is not a whole number such as 8"),
        ("train flat --seed many", "'many' is not a whole number such as 8"),
        ("eval gap --value 1,5", "'1,5' is not a number such as 0.5"),
    ],
)
def test_what_is_no_number_is_told_in_plain_words(capsys, words, said):
    with pytest.raises(SystemExit) as stopped:
        cli.main(words.split())
    err = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert stopped.value.code == 2
    assert said in err
    assert not re.search("int\\(|float:|literal", err)


def test_a_missing_log_is_told_before_torch_is_loaded():
    program = """
import contextlib, sys
from arrive import cli
with contextlib.suppress(SystemExit):
    cli.main(["actuator", "fit", "nothing.csv"])
assert "torch" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "arrive: cannot read nothing.csv: No such file or directory\n")


def test_an_out_folder_that_cannot_be_written_is_named(refused, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for out in (tmp_path / "file", tmp_path / "file" / "run"):
        assert f"cannot write to the run folder {out}" in refused("train", "flat", "--out", out)
    assert (tmp_path / "file").read_text() == "not a folder"


def test_an_existing_run_is_not_overwritten(refused, trained):
    before = (trained / "checkpoint.pt").read_bytes()
    assert f"--resume {trained}" in refused("train", "flat", "--out", trained)
    assert (trained / "checkpoint.pt").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["pit"], ["flat, not pit", "trains on"]),
        (["flat,pit"], ["trains on flat, not flat,pit"]),
        (["flat", "--set", "ppo.gamma=0.9"], ["keeps its configuration"]),
        (["flat", "--num-envs", "32"], ["keeps its configuration"]),
        (["flat", "--robot", "go2"], ["keeps its configuration"]),
        (["flat", "--out", "elsewhere"], ["keeps its configuration"]),
        (["flat", "--start-from", "elsewhere"], ["keeps its configuration"]),
    ],
)
def test_a_resumed_run_keeps_its_configuration(refused, trained, options, words):
    before = (trained / "checkpoint.pt").read_bytes()
    message = refused("train", *options, "--resume", trained)
    for word in words:
        assert word in message
    assert (trained / "checkpoint.pt").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--episodes", "0"], ["episodes must be at least 1, not 0"]),
        (["--episodes", "-5"], ["episodes must be at least 1, not -5"]),
        (["--level", "10"], ["level 10 of flat is out of range", "0 to "]),
        (["--terrain", "pit", "--level", "2"], ["level 2 of pit is out of range", "0 to 1"]),
        (["--terrain", "pit", "--level", "-1"], ["level -1 of pit is out of range"]),
        (["--terrain", "pits"], ["unknown terrain", *FAMILIES]),
    ],
)
def test_an_evaluation_of_nothing_is_refused(refused, trained, options, words):
    message = refused("eval", trained, "--threads", "1", *options)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("levels", "expected"), [(None, [0, 3, 6, 10, 13, 16, 19, 23, 26, 29]), (2, [0, 29]), (30, list(range(30)))]
)
def test_an_evaluation_spreads_over_the_policys_own_levels(levels, expected):
    """All 30 levels of `robust` would be 15,000 episodes."""
    policy = SimpleNamespace(config=make_config(parse_families("flat")))
    cells = evaluation._spread(Eval(Path("run"), levels=levels), policy, FAMILIES["pit"])
    assert [(cell.level, cell.value) for cell in cells] == [(i, FAMILIES["pit"].value(i, 30)) for i in expected]


def test_a_truncated_policy_is_refused(refused, trained, tmp_path):
    data = (trained / "policy.pt").read_bytes()
    path = tmp_path / "policy.pt"
    path.write_bytes(data[: len(data) // 2])
    message = refused("eval", path)
    assert f"cannot read {path}" in message
    assert "truncated" in message


def test_a_truncated_checkpoint_is_not_resumed(refused, trained, tmp_path):
    folder = tmp_path / "copy"
    folder.mkdir()
    data = (trained / "checkpoint.pt").read_bytes()
    (folder / "checkpoint.pt").write_bytes(data[:-100])
    (folder / "config.json").write_bytes((trained / "config.json").read_bytes())
    assert "truncated" in refused("train", "flat", "--resume", folder, "--iterations", "9", "--threads", "1")
    assert (folder / "checkpoint.pt").stat().st_size == len(data) - 100


def test_a_damaged_configuration_is_not_resumed(refused, trained, tmp_path):
    path = tmp_path / "config.json"
    path.write_text((trained / "config.json").read_text()[:300])
    assert f"cannot read {path}" in refused("train", "flat", "--resume", tmp_path)
    content = json.loads((trained / "config.json").read_text())
    content["config"]["ppo"]["momentum"] = 0.9
    path.write_text(json.dumps(content))
    assert "momentum" in refused("train", "flat", "--resume", tmp_path)


def test_a_result_that_cannot_be_written_is_named(refused, trained, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    out = tmp_path / "file" / "result.json"
    assert f"cannot write {out}" in refused("eval", trained, "--episodes", "1", "--threads", "1", "--json", out)


def test_list_names_everything(capsys):
    cli.main(["list"])
    text = capsys.readouterr().out
    for name in (*FAMILIES, *PRESETS, *TASKS, *ROBOTS, *REWARDS, "crash_cost"):
        assert name in text
    cli.main(["list", "presets"])
    text = capsys.readouterr().out
    assert all(name in text for name in PRESETS)
    assert "stairs" not in text


def test_list_takes_policies_without_targets(capsys, monkeypatch, tmp_path):
    config = make_config(parse_families("flat"), task="velocity")
    (tmp_path / "walker").mkdir()
    write_config(tmp_path / "walker", config)
    monkeypatch.setattr(names, "SHIPPED", tmp_path)
    monkeypatch.setattr(names, "shipped_names", lambda: ["walker"])
    cli.main(["list", "policies"])
    assert "not evaluated; anymal_c, trained on flat" in capsys.readouterr().out


def test_list_says_by_which_rule_a_value_counts_as_solved(capsys):
    """A weak value hides the harder ones, so a policy may open at a value below others that it solves."""
    cli.main(["list", "policies"])
    solved = amounts(solved_beside(SHIPPED / "gap"))[0]
    assert f"solves {solved} and everything easier in 95 %" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("arguments", [["--help"], []])
def test_help_names_the_commands(capsys, arguments):
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("train", "eval", "list", "--version", "--debug", "--import"))


@pytest.mark.parametrize("command", [["list", "config"], ["train", "--help"], ["bench", "--help"]], ids=" ".join)
def test_every_field_of_the_configuration_is_shown_with_unit_default_and_range(capsys, command):
    with contextlib.suppress(SystemExit):
        cli.main(command)
    text = capsys.readouterr().out
    for task in TASKS:
        config = make_config(parse_families("flat"), task=task)
        assert all(f"  {row.path} = " in text for row in rows(config))
    assert "  task.reward_window_s = 2.0 [s] (above 0)\n      Duration T_r of the task reward" in text
    assert "  task.rewards.stall_cost.weight = -1.0 (at most 0)\n      1 while waiting" in text


COMMANDS = ("train", "eval", "report", "energy", "gait", "drive", "play", "showreel", "export", "verify", "bench",
            "actuator", "list")  # fmt: skip


def test_help_and_lists_load_no_torch_and_no_matplotlib():
    """They say all the same what the code defines."""
    program = f"""
import contextlib, sys
from arrive import cli
for words in (["--version"], ["--help"], *([name, "--help"] for name in {COMMANDS}), ["list"], ["list", "config"]):
    with contextlib.suppress(SystemExit):
        cli.main(words)
    loaded = [name for name in ("torch", "rsl_rl", "matplotlib", "onnxruntime", "viser") if name in sys.modules]
    assert not loaded, (words, loaded)
import arrive.commands.evaluation, arrive.commands.training
assert "matplotlib" not in sys.modules, "only what draws needs it"
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    for name in (*FAMILIES, *PRESETS, *TASKS, *ROBOTS, *REWARDS, "crash_cost", "ppo.gamma", *shipped_names()):
        assert name in result.stdout


def test_an_error_shows_terminal_commands_and_line_breaks_as_escapes(refused):
    assert r"a\x1b[2J\nb is not a run folder" in refused("train", "flat", "--resume", "a\x1b[2J\nb")
    assert shown("a\x1b[2J\n\udcffé") == r"a\x1b[2J\n\udcffé"


def test_without_graphics_an_evaluation_says_so_in_one_line(capsys, trained, tmp_path, monkeypatch):
    graphics.graphics_backend.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    try:
        evaluation = ["eval", str(trained), "--episodes", "1", "--threads", "1"]
        cli.main([*evaluation, "--json", str(tmp_path / "result.json"), "--pictures", str(tmp_path / "pictures")])
    finally:
        graphics.graphics_backend.cache_clear()
    out, err = capsys.readouterr()
    lines = [line for line in (out + err).splitlines() if "pictures" in line]
    assert len(lines) == 1
    assert lines[0].startswith("no pictures: no offscreen graphics library works here")
    assert "libosmesa6" in lines[0]
    assert (tmp_path / "result.json").is_file()
    assert not any((tmp_path / "pictures").glob("*"))


def test_train_resume_and_evaluate(capsys, monkeypatch, tmp_path):
    """The whole way through the command line."""
    monkeypatch.setattr(pictures, "FRAME_SIZE", (64, 48))
    monkeypatch.setattr(pictures, "FILM_SIZE", (96, 64))
    folder, result = tmp_path / "runs" / "first", tmp_path / "results" / "first.json"
    command = ["train", "flat", "--iterations", "3", "--seed", "7", "--out", str(folder), *TINY]
    monkeypatch.setattr(sys, "argv", ["arrive", *command])
    cli.main(command)
    assert f"run: {folder} (3 iterations" in capsys.readouterr().out
    check_run_folder(folder)
    first = torch.load(folder / "checkpoint.pt", weights_only=True)

    cli.main(["train", "flat", "--resume", str(folder), "--iterations", "5", "--threads", "1"])
    assert f"run: {folder} (5 iterations" in capsys.readouterr().out
    with (folder / "log.csv").open(newline="") as file:
        assert [row["iteration"] for row in csv.DictReader(file)] == ["1", "2", "3", "4", "5"]
    last = torch.load(folder / "checkpoint.pt", weights_only=True)
    assert (first["iteration"], last["iteration"]) == (3, 5)
    assert last["samples"] == 5 * 16 * 8

    record = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(record | {"commit": "of the training"}))
    evaluation = ["eval", str(folder), "--terrain", "flat,pit", "--episodes", "4", "--seed", "3", "--threads", "1"]
    cli.main([*evaluation, "--layout", "evaluation", "--json", str(result), "--pictures", str(tmp_path / "pictures")])
    out = capsys.readouterr().out
    assert "flat" in out
    assert "95 %" in out
    check_result(json.loads(result.read_text()), json.loads((folder / "config.json").read_text()))
    check_pictures(tmp_path / "pictures", out)


def check_run_folder(folder) -> None:
    files = {path.name for path in folder.iterdir()}
    assert files == {"config.json", "checkpoint.pt", "policy.pt", "log.csv", "curves.png", "tensorboard"}
    assert any((folder / "tensorboard").iterdir())
    assert Image.open(folder / "curves.png").size[0] > 500
    record = json.loads((folder / "config.json").read_text())
    assert set(record) == {"config", "commit", "command", "seed", "samples_before", "imports"}
    assert record["seed"] == record["config"]["seed"] == 7
    assert record["command"].startswith("arrive train flat --iterations 3 --seed 7")
    assert record["commit"]
    assert record["config"]["ppo"]["hidden"] == [16]
    policy = torch.load(folder / "policy.pt", weights_only=True)
    assert policy["config"] == record["config"]
    assert policy["commit"]


def check_result(content: dict, record: dict) -> None:
    """The result says how it was measured, and of which training it is."""
    assert set(content) == {"families", "policy", "protocol", "commit"}
    assert content["protocol"] == {
        "name": "arrival",
        "episodes": 4,
        "seed": 3,
        "layout": "evaluation",
        "worlds_per_level": record["config"]["terrain"]["variants"],
        "randomisation": record["config"]["randomisation"],
        "observation_noise": True,
    }
    assert content["commit"] == commit()
    assert content["policy"]["commit"] == "of the training"
    assert content["policy"]["samples"] == 640
    assert content["policy"]["config"]["terrain"]["families"] == ["flat"]
    assert list(content["families"]) == ["flat", "pit"]
    pit = content["families"]["pit"]
    assert set(pit) == {"parameter", "unit", "levels"}
    assert pit["unit"] == "m"
    assert [level["level"] for level in pit["levels"]] == [0, 1]
    assert [level["value"] for level in pit["levels"]] == [FAMILIES["pit"].lowest, FAMILIES["pit"].highest]
    for family in content["families"].values():
        for level in family["levels"]:
            assert set(level) == {
                "level", "value", "episodes", "success", "interval", "median_distance_m", "failures",
            }  # fmt: skip
            assert level["episodes"] == 4
            assert round(level["success"] * 4) + sum(level["failures"].values()) == 4
            low, high = level["interval"]
            assert 0.0 <= low <= level["success"] <= high <= 1.0


def check_pictures(folder, out: str) -> None:
    """A strip per cell and one film, or one line that says why there are none."""
    made = sorted(path.name for path in folder.iterdir())
    try:
        graphics.graphics_backend()
    except graphics.GraphicsUnavailable:
        assert out.count("no pictures: ") == 1
        assert made == []
        return
    assert out.count("pictures: ") == 1
    filmed = [name for name in made if name.endswith(".mp4")]
    assert len(filmed) == 2, "one of each terrain"
    assert filmed[0] == "flat.mp4"
    assert filmed[1].startswith("pit_")
    assert len([name for name in made if name.endswith(".png")]) == 3
    assert len(made) == 5
    for name in made[:-1]:
        if name.endswith(".png"):
            assert Image.open(folder / name).size[0] > 6 * 64
    with imageio.get_reader(folder / "flat.mp4") as film:
        assert sum(1 for _ in film) >= 2


def test_an_option_without_a_value_is_not_its_default(refused):
    assert "--units has no value" in refused("actuator", "fit", "log.npz", "--units", "--")


def test_graphics_that_mujoco_does_not_know_are_told(refused, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "cpu")
    assert "MUJOCO_GL must be egl, osmesa, glfw, glx, disable or unset, not 'cpu'" in refused("list")
