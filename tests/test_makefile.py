"""The targets of the Makefile, with a program in the place of `arrive` that takes down its arguments."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ARRIVE = """#!/bin/sh
echo "$*" >> told
case "$*" in *--out*) mkdir -p runs/demo && touch runs/demo/checkpoint.pt;; esac
[ "$1" != "$FAILS" ] || exit 130
"""


@pytest.fixture
def make(tmp_path):
    """Runs `make demo` in a checkout where everything is installed; returns its status, output and commands."""
    shutil.copy(Path(__file__).parents[1] / "Makefile", tmp_path)
    for name in ("pyproject.toml", "setup.py"):
        (tmp_path / name).touch()
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    program = tmp_path / ".venv" / "bin" / "arrive"
    program.write_text(ARRIVE)
    program.chmod(0o755)
    (tmp_path / ".venv" / ".installed").touch()

    def run(fails: str = "") -> tuple[int, str, list[str]]:
        (tmp_path / "told").write_text("")
        done = subprocess.run(
            ["make", "demo"], cwd=tmp_path, env=os.environ | {"FAILS": fails}, capture_output=True, text=True
        )
        return done.returncode, done.stdout, (tmp_path / "told").read_text().splitlines()

    return run


def test_a_second_demo_resumes_the_first_and_says_how_to_begin_anew(make):
    evaluation = "eval runs/demo --episodes 1000"
    assert make()[2] == ["train flat --minutes 6 --out runs/demo", evaluation]
    status, said, told = make()
    assert (status, told) == (0, ["train flat --minutes 6 --resume runs/demo", evaluation])
    assert "rm -r runs/demo" in said


def test_a_demo_that_is_interrupted_is_not_measured(make):
    for _ in range(2):
        status, _, told = make("train")
        assert status != 0
        assert [words.split()[0] for words in told] == ["train"]
