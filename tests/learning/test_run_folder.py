"""A run's folder: one writer at a time, and damaged files are errors of one line that say what to do."""

import errno
import json
import math
import os
import re
import shutil
import subprocess
from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

from arrive import __version__, cli, files
from arrive.commands import training
from arrive.commands.options import Train
from arrive.config import override
from arrive.errors import ArriveError
from arrive.learning import rundir
from arrive.learning.checkpoint import load_checkpoint, load_policy_file
from arrive.learning.display import TrainingDisplay
from arrive.learning.logs import read_log
from arrive.learning.rundir import LOCK_NAME, new_run_folder
from arrive.lock import Lock
from arrive.presets import get_preset
from arrive.startup import INTERRUPTED
from tiny_runs import TINY

WHOLE = ["checkpoint.pt", "config.json", "curves.png", "log.csv", "policy.pt", "tensorboard"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """In an empty folder: a command may write to ./runs."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """The folder of a run of 3 iterations."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    begin(folder, 3)
    return folder


@pytest.fixture
def run(trained, tmp_path) -> Path:
    """A copy of that run."""
    return Path(shutil.copytree(trained, tmp_path / "run"))


def begin(folder: Path, iterations: int, *settings: str) -> None:
    options = ("--num-envs", "4", "--threads", "1", "--iterations", str(iterations), "--out", str(folder))
    cli.main(["train", "flat", *options, "--set", *TINY, *settings])


def resume(folder: Path, iterations: int = 4) -> None:
    cli.main(["train", "flat", "--threads", "1", "--iterations", str(iterations), "--resume", str(folder)])


@pytest.fixture
def refused(capsys):
    """Do what must end with this status and one line on standard error; returns that line."""

    def run(action, *arguments, status: int = 1) -> str:
        with pytest.raises(SystemExit) as stopped:
            action(*arguments)
        out, err = capsys.readouterr()
        assert stopped.value.code == status, err
        assert err.startswith("arrive: ")
        assert err.count("\n") == 1, err
        assert "Traceback" not in out + err
        return err

    return run


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# One writer.


def test_a_folder_that_is_written_by_another_process_is_left_alone(run, refused):
    before = (run / "checkpoint.pt").read_bytes()
    with Lock(run / LOCK_NAME, "the run"):
        assert f"the run in {run} is in use by process {os.getpid()}" in refused(resume, run)
    assert (run / "checkpoint.pt").read_bytes() == before
    resume(run)
    assert names(run) == WHOLE


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_the_commit_is_that_of_the_codes_own_checkout(tmp_path, monkeypatch):
    """A package that is installed into another project's checkout does not name that project's commit."""
    project = tmp_path / "project"
    code = project / "venv" / "rundir.py"
    code.parent.mkdir(parents=True)
    code.write_text("")
    monkeypatch.setattr(rundir, "__file__", str(code))
    assert rundir.commit() == f"unknown (version {__version__}, not in a git checkout)"

    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", "-C", str(project), *identity, *arguments], check=True, capture_output=True)

    git("init")
    git("commit", "--allow-empty", "-m", "of the project")
    assert rundir.commit().startswith("unknown")
    git("add", "venv")
    git("commit", "-m", "of the code")
    assert re.fullmatch(r"[0-9a-f]{12}", rundir.commit())
    code.write_text("changed")
    assert re.fullmatch(r"[0-9a-f]{12}\+", rundir.commit())


def test_two_new_runs_cannot_share_a_folder(tmp_path, refused):
    (tmp_path / "new").mkdir()
    with Lock(tmp_path / "new" / LOCK_NAME, "the run"):
        assert "in use by process" in refused(begin, tmp_path / "new", 1)
        assert names(tmp_path / "new") == [LOCK_NAME]


def test_runs_that_begin_in_the_same_second_get_folders_of_their_own(monkeypatch):
    monkeypatch.setattr(rundir.time, "strftime", lambda pattern: "20260101-000000")
    config = override(get_preset("paper"), ())
    folders = [new_run_folder(config, None) for _ in range(3)]
    assert len({folder.resolve() for folder in folders}) == 3
    assert all(folder.is_dir() for folder in folders)


# Begun with the first checkpoint.


def test_a_start_that_was_interrupted_can_be_repeated(run, refused):
    """Killed between the configuration and the first checkpoint, or while that was written."""
    for name in ("checkpoint.pt", "policy.pt", "log.csv", "curves.png"):
        (run / name).unlink()
    (run / ".checkpoint.pt.abc.tmp.pt").write_text("half")
    (run / LOCK_NAME).write_text(json.dumps({"pid": 1, "host": os.uname().nodename}))
    message = f"no checkpoint.pt, because its start was interrupted; start it again with --out {run}"
    assert message in refused(resume, run)
    begin(run, 2)
    assert names(run) == WHOLE
    assert len(read_log(run)["iteration"]) == 2


@pytest.mark.parametrize("name", ["checkpoint.pt", "policy.pt", "log.csv"])
def test_a_folder_with_a_checkpoint_is_not_started_again(run, refused, name):
    for other in {"checkpoint.pt", "policy.pt", "log.csv"} - {name}:
        (run / other).unlink()
    before = (run / name).read_bytes()
    assert f"already holds a run ({name})" in refused(begin, run, 1)
    assert (run / name).read_bytes() == before


@pytest.mark.parametrize("name", ["notes.txt", "config.json", ".notes.tmp", "src"])
def test_a_folder_with_other_files_is_not_used_for_a_run(tmp_path, refused, name):
    """A run would replace the user's own config.json."""
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "notes.md").write_text("mine")
    if name == "src":
        (folder / name).mkdir()
    else:
        (folder / name).write_text('{"mine": 1}')
    before = names(folder)
    assert f"{folder} holds other files, such as" in refused(begin, folder, 1)
    assert names(folder) == before


def test_a_configuration_of_another_program_is_not_replaced(tmp_path, refused):
    (tmp_path / "config.json").write_text('{"mine": 1}')
    assert "holds other files, such as config.json" in refused(begin, tmp_path, 1)
    assert (tmp_path / "config.json").read_text() == '{"mine": 1}'


def test_files_of_a_killed_save_are_removed_by_a_resume(run):
    (run / ".policy.pt.abc.tmp.pt").write_text("half")
    resume(run)
    assert names(run) == WHOLE


def test_a_failed_start_leaves_no_folder(tmp_path, refused):
    assert "nowhere" in refused(cli.main, ["train", "flat", "--start-from", "nowhere", "--out", str(tmp_path / "new")])
    assert not (tmp_path / "new").exists()


# Damaged files.


def lines(run: Path) -> list[str]:
    return (run / "log.csv").read_text().splitlines()


LOG_DAMAGE = {
    "a row missing": (lambda rows: [*rows[:2], *rows[3:]], "no row for iteration 2"),
    "the last row missing": (lambda rows: rows[:-1], "no row for iteration 3"),
    "a row twice": (lambda rows: [*rows[:3], *rows[2:]], "line 4: iteration 2 does not come after 2"),
    "rows in disorder": (
        lambda rows: [rows[0], rows[2], rows[1], rows[3]],
        "line 3: iteration 1 does not come after 2",
    ),
    "a value missing": (lambda rows: [*rows[:2], rows[2].rpartition(",")[0], rows[3]], "line 3: it has .* values"),
    "a value too many": (lambda rows: [*rows[:2], rows[2] + ",1", rows[3]], "line 3: it has .* values"),
    "a word for a number": (lambda rows: [*rows[:3], rows[3].rpartition(",")[0] + ",much"], "line 4: .*not 'much'"),
    "no whole iteration": (lambda rows: [*rows[:3], "2.5" + rows[3][1:]], "line 4: the iteration must be"),
    "an empty line": (lambda rows: [*rows[:2], "", *rows[2:]], "line 3: it has 0 values"),
    "an open quote": (lambda rows: [*rows[:2], '"' + rows[2], rows[3]], "line 3"),
    "a name twice": (lambda rows: [rows[0] + ",iteration", *rows[1:]], "not a log of arrive"),
    "another file": (lambda rows: ["hello, world"], "not a log of arrive"),
}


@pytest.mark.parametrize("damage", LOG_DAMAGE)
def test_a_damaged_log_is_not_continued(run, refused, damage):
    change, words = LOG_DAMAGE[damage]
    (run / "log.csv").write_text("".join(f"{line}\n" for line in change(lines(run))))
    before = {name: (run / name).read_bytes() for name in ("log.csv", "checkpoint.pt", "policy.pt")}
    message = refused(resume, run)
    assert re.search(rf"log\.csv.*{words}", message)
    assert {name: (run / name).read_bytes() for name in before} == before


def test_a_binary_log_is_not_continued(run, refused):
    (run / "log.csv").write_bytes(b"\xff\x00" * 100)
    assert "not UTF-8" in refused(resume, run)


def test_rows_after_the_checkpoint_are_dropped(run):
    """Killed between a row and the checkpoint, within a row."""
    text = (run / "log.csv").read_text()
    later = lines(run)[3]
    (run / "log.csv").write_text(text + "4" + later[1:] + "\n5" + later[1:] + "\n6,0.")
    resume(run, 5)
    assert read_log(run)["iteration"] == [1, 2, 3, 4, 5]


def test_a_missing_log_is_started_again_with_a_message(run, capsys):
    (run / "log.csv").unlink()
    resume(run, 5)
    assert "log.csv is missing: a new log starts at iteration 4" in capsys.readouterr().out
    assert read_log(run)["iteration"] == [4, 5]
    resume(run, 6)
    assert "starts at iteration 4: earlier rows are missing" in capsys.readouterr().out
    assert read_log(run)["iteration"] == [4, 5, 6]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"config": 3}', '{"config": {}}', "\x00"], ids=repr)
def test_a_damaged_configuration_is_one_line(run, refused, content):
    (run / "config.json").write_text(content)
    assert f"cannot read {run / 'config.json'}" in refused(resume, run)


def test_a_file_in_place_of_the_tensorboard_folder_is_one_line(run, refused):
    shutil.rmtree(run / "tensorboard")
    (run / "tensorboard").write_text("in the way")
    assert "tensorboard" in refused(resume, run)
    (run / "tensorboard").unlink()
    resume(run)


def test_damaged_tensorboard_files_do_not_stop_a_resume(run):
    for path in (run / "tensorboard").iterdir():
        path.write_bytes(b"damaged")
    resume(run)


def do_at_iteration(monkeypatch, iteration: int, action) -> None:
    """Let somebody interfere while training."""

    def update(display, report):
        if report.iteration == iteration:
            action()

    monkeypatch.setattr(TrainingDisplay, "update", update)


@pytest.mark.parametrize("what", ["removed", "changed"])
def test_a_log_that_is_changed_from_outside_ends_training(run, refused, monkeypatch, what):
    path = run / "log.csv"
    touch = path.unlink if what == "removed" else lambda: path.write_text(path.read_text() + "more")
    do_at_iteration(monkeypatch, 5, touch)
    message = refused(resume, run, 9)
    assert f"log.csv was {what} during training" in message
    assert f"--resume {run}" in message


def test_a_folder_that_is_removed_while_training_ends_it(run, refused, monkeypatch):
    do_at_iteration(monkeypatch, 4, lambda: shutil.rmtree(run))
    assert f"{run}" in refused(resume, run, 4)
    assert not run.exists(), "it was made again with a part of the run"


# A disk that is full.


def fail_from(monkeypatch, calls: int) -> list[str]:
    """Let every write from this one on fail as on a full disk; returns what was written before."""
    done, replace = [], os.replace

    def full(source, target):
        if len(done) >= calls:
            raise OSError(errno.ENOSPC, "No space left on device")
        done.append(Path(target).name)
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", full)
    return done


@pytest.mark.parametrize("calls", range(7))
def test_a_disk_that_is_full_at_any_moment_of_a_new_run(tmp_path, refused, monkeypatch, calls):
    folder = tmp_path / "new"
    with monkeypatch.context() as patch:
        done = fail_from(patch, calls)
        assert "No space left on device" in refused(begin, folder, 2)
    assert len(done) == calls
    begun = (folder / "checkpoint.pt").exists()
    assert begun == ("checkpoint.pt" in done)
    (resume if begun else begin)(folder, 2)
    assert names(folder) == WHOLE
    assert read_log(folder)["iteration"] == [1, 2]


@pytest.mark.parametrize("calls", range(4))
def test_a_disk_that_is_full_loses_nothing_of_a_resumed_run(run, refused, monkeypatch, calls):
    with monkeypatch.context() as patch:
        fail_from(patch, calls)
        assert "No space left on device" in refused(resume, run)
    assert load_checkpoint(run / "checkpoint.pt")[1]["iteration"] == 3
    load_policy_file(run / "policy.pt")
    assert read_log(run)["iteration"][:3] == [1, 2, 3]
    resume(run)
    assert read_log(run)["iteration"] == [1, 2, 3, 4]


@pytest.mark.parametrize("out", ["/proc/new", "x" * 300, "a/" * 3000, "\udcff"], ids=["proc", "long", "deep", "bytes"])
def test_a_folder_that_cannot_be_made_is_one_line(refused, out):
    refused(begin, out, 1)


# Interrupts.


def interrupt(*arguments, **options):
    raise KeyboardInterrupt


def test_ctrl_c_during_the_start_says_how_to_go_on(tmp_path, run, refused, monkeypatch):
    monkeypatch.setattr(training, "build_env", interrupt)
    assert "interrupted; nothing was trained yet" in refused(begin, tmp_path / "new", 1, status=INTERRUPTED)
    assert not (tmp_path / "new").exists()
    assert (
        f"interrupted; resume from the last checkpoint with: arrive train flat --resume {run} --iterations 4"
        in refused(resume, run, status=INTERRUPTED)
    )
    assert names(run) == WHOLE


@pytest.mark.parametrize("name", [option.name for option in fields(Train)[1:]])
def test_the_command_that_resumes_has_every_option_that_the_run_does_not_keep(tmp_path, monkeypatch, name):
    """Whatever is not in the run's configuration, nor says which run it is."""
    monkeypatch.setattr("arrive.plugins._imported", {"mine": "/my/mine.py"})
    (tmp_path / "checkpoint.pt").touch()
    value = {"threads": 3, "device": "cpu", "logger": "wandb", "samples": "40M"}.get(name, 7)
    said = training._how_to_go_on(replace(Train("flat"), **{name: value}), tmp_path)
    kept = {"preset", "robot", "task", "num_envs", "seed", "resume", "start_from", "out", "config", "set"}
    assert (f"--{name.replace('_', '-')} {value}" in said) == (name not in kept)
    assert "--import /my/mine.py" in said


def test_ctrl_c_before_that_is_one_line_too(tmp_path, refused, monkeypatch):
    monkeypatch.setattr(training, "choose_device", interrupt)
    assert refused(begin, tmp_path / "new", 1, status=INTERRUPTED) == "arrive: interrupted\n"


def test_a_second_ctrl_c_ends_at_once(run, refused, monkeypatch):
    do_at_iteration(monkeypatch, 4, interrupt)
    assert "resume from the last checkpoint" in refused(resume, run, 5, status=INTERRUPTED)
    monkeypatch.undo()
    resume(run, 5)
    assert read_log(run)["iteration"] == [1, 2, 3, 4, 5]


# What goes wrong otherwise.


def test_debug_prints_the_traceback(tmp_path, refused):
    command = ["train", "flat", "--resume", str(tmp_path)]
    refused(cli.main, command)
    with pytest.raises(ArriveError, match="not a run folder"):
        cli.main([*command, "--debug"])


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RuntimeError("two\nlines"), "unexpected RuntimeError: two lines. --debug shows where"),
        (MemoryError(), "not enough memory"),
        (OSError(errno.EROFS, "Read-only file system", "/mnt/run"), "Read-only file system: /mnt/run"),
    ],
    ids=str,
)
def test_an_unexpected_error_is_one_line(tmp_path, refused, monkeypatch, error, words):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(training, "build_env", fail)
    assert words in refused(begin, tmp_path / "new", 1)


@pytest.mark.parametrize(("threads", "words"), [("-1", "must be at least 0"), ("1000000", "must be 0 to")])
def test_a_wrong_number_of_threads_is_refused(refused, threads, words):
    assert f"--threads {words}" in refused(cli.main, ["train", "flat", "--threads", threads])


def test_a_run_whose_robots_diverge_says_so(tmp_path, capsys):
    begin(tmp_path / "new", 2, "randomisation.start_speed=10000")
    assert "end because the simulation diverges. Likely causes: physics.timestep_s" in capsys.readouterr().out
    assert read_log(tmp_path / "new")["warnings/diverging"][-1] == 1.0


def test_a_sound_run_warns_of_nothing(trained):
    columns = read_log(trained)
    assert not [name for name in columns if name.startswith("warnings/")]
    assert all(math.isfinite(share) for share in columns["episodes/diverged"])
    assert torch.load(trained / "checkpoint.pt", weights_only=True)["state"]["statistics"]["diverged"] == 0
