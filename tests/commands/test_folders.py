"""A folder that is removed or replaced at any moment of a command: one line and status 1, or the work is done."""

import contextlib
import os
import random
import shutil
import sys
from pathlib import Path

import pytest

from arrive import cli
from arrive.commands import evaluation
from tiny_runs import train_words

MOMENTS = int(os.environ.get("ARRIVE_FOLDER_MOMENTS", "1"))
"""Moments of each command and kind of damage that are tried."""
ACCESSES = ("open", "os.rename", "os.mkdir", "os.remove", "os.listdir", "os.scandir", "os.rmdir", "os.chmod")


class Saboteur:
    """Damages a folder just before an access to it, whatever in the program makes the access."""

    def __init__(self) -> None:
        self._folder = ""
        self.accesses = 0
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple) -> None:
        if not self._folder or event not in ACCESSES or not isinstance(arguments[0], str | os.PathLike):
            return
        if os.fspath(arguments[0]).startswith(self._folder):
            self.accesses += 1
            if self.accesses == self._moment:
                folder, self._folder = Path(self._folder), ""
                self._damage(folder)

    @contextlib.contextmanager
    def at(self, folder: Path, moment: int, damage):
        self._moment, self._damage, self.accesses = moment, damage, 0
        self._folder = str(folder)
        try:
            yield
        finally:
            self._folder = ""


SABOTEUR = Saboteur()


def removed(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def emptied(folder: Path) -> None:
    removed(folder)
    folder.mkdir()


def replaced_by_a_file(folder: Path) -> None:
    removed(folder)
    folder.write_text("something else")


def replaced_by_folders(folder: Path) -> None:
    """Every file is a folder now."""
    for path in folder.glob("*"):
        if path.is_file():
            path.unlink()
            path.mkdir()


def cut(folder: Path) -> None:
    """Every file has lost its second half."""
    for path in folder.glob("*"):
        if path.is_file():
            os.truncate(path, path.stat().st_size // 2)


DAMAGES = (removed, emptied, replaced_by_a_file, replaced_by_folders, cut)


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "run"
    cli.main(train_words(2, str(folder)))
    return folder


COMMANDS = {
    "train": " ".join(train_words(2)),
    "resume": "train flat --threads 1 --iterations 4 --resume run",
    "eval": "eval run --level 0 --episodes 1 --threads 1 --json run/eval.json",
    "export": "export run -o run/policy.onnx",
    "drive": "drive run --script drive.csv --log run/drive.npz",
    "record": "actuator record -o run/record.csv --seconds 0.5",
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_folder_that_changes_at_any_moment(trained, tmp_path, monkeypatch, capsys, command, damage):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    # Films take a minute, and are written as the other files are.
    monkeypatch.setattr(evaluation, "_write_pictures", lambda *arguments, **options: None)
    run, other = work / "run", tmp_path / "other"
    (work / "drive.csv").write_text("time_s,forward,left,heading_rad\n0,1,0,0\n0.2,0,0,\n0.4,0,0,\n")
    other.write_text("kept")
    words = COMMANDS[command].replace("run", str(run)).split()

    def attempt(moment: int) -> int:
        shutil.rmtree(run) if run.is_dir() else run.unlink(missing_ok=True)
        if command != "train":
            shutil.copytree(trained, run)
        with SABOTEUR.at(run, moment, damage):
            try:
                cli.main(words)
                status = 0
            except SystemExit as stop:
                status = stop.code
        said = capsys.readouterr()
        case = (command, damage.__name__, moment, said.err)
        assert status in (0, 1), case
        assert said.err.count("\n") == status, case
        assert "Traceback" not in said.out + said.err, case
        assert "unexpected" not in said.err, case
        assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "work"], case
        assert sorted(path.name for path in work.iterdir() if path != run) == ["drive.csv"], case
        return status

    assert attempt(0) == 0
    count = SABOTEUR.accesses
    assert count > 0
    for moment in sorted(random.Random(7).sample(range(1, count + 1), min(count, MOMENTS))):
        attempt(moment)
