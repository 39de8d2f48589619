"""Output that nobody reads or that cannot be written: the work is done, and at most one line says so."""

import contextlib
import os
import subprocess
import sys
import time

import pytest

from arrive.learning.checkpoint import load_checkpoint
from arrive.output import Lasting
from arrive.startup import INTERRUPTED
from tiny_runs import train_words

PATIENCE_S = 300.0


def training(iterations: int) -> list[str]:
    return [sys.executable, "-m", "arrive", *train_words(iterations)]


def trained(folder) -> int:
    return load_checkpoint(folder / "run" / "checkpoint.pt")[1]["iteration"]


def test_a_training_whose_reader_leaves_goes_on_to_its_end(tmp_path):
    """As in `arrive train flat | head -1`."""
    reader, writer = os.pipe()
    process = subprocess.Popen(training(3), cwd=tmp_path, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    os.read(reader, 10)
    os.close(reader)
    assert process.communicate(timeout=PATIENCE_S)[1] == b""
    assert process.returncode == 0
    assert trained(tmp_path) == 3
    assert (tmp_path / "run" / "curves.png").exists()


@pytest.mark.usefixtures("hears_hangups")
def test_a_training_whose_terminal_closes_saves_and_ends(tmp_path):
    here, there = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
         "os.execv(sys.argv[1], sys.argv[1:])", *training(1_000_000)],
        cwd=tmp_path, stdin=there, stdout=there, stderr=there, start_new_session=True,
    )  # fmt: skip
    os.close(there)
    os.set_blocking(here, False)
    log, deadline = tmp_path / "run" / "log.csv", time.monotonic() + PATIENCE_S
    while not (log.exists() and log.read_text().count("\n") > 2):
        with contextlib.suppress(BlockingIOError):
            os.read(here, 100_000)
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.close(here)
    process.wait(timeout=PATIENCE_S)
    assert process.returncode == INTERRUPTED
    assert trained(tmp_path) >= 2
    assert (tmp_path / "run" / "curves.png").exists()
    assert not (tmp_path / "run" / "run.lock").exists()


@pytest.mark.parametrize(
    "words", [("arrive", "list"), ("arrive", "--version"), ("arrive", "eval", "--help"), ("arrive.cli", "--version")]
)
def test_a_full_disk_is_one_line(tmp_path, words):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", *words], stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )
    assert done.returncode == 1
    assert done.stderr == "arrive: cannot write to standard output: No space left on device\n"


def test_a_closed_descriptor_is_not_given_to_a_file_of_ours(tmp_path):
    program = (
        "import os; [os.close(i) for i in range(3)]\n"
        "from arrive.output import make_output_last; make_output_last(); print('lost')\n"
        f"file = open({str(tmp_path / 'file')!r}, 'w'); file.write(str(file.fileno())); file.flush(); os.write(1, b'x')"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
    assert int((tmp_path / "file").read_text()) > 2


def test_writing_never_raises():
    reader, writer = os.pipe()
    os.close(reader)
    stream = Lasting(writer, "wb")
    assert stream.write(b"lost") == 4
    assert isinstance(stream.failure, BrokenPipeError)
    assert stream.write(memoryview(b"more")) == 4
