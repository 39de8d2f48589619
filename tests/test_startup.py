"""Ctrl-C at any moment prints one line and no traceback, and keeps what was saved."""

import os
import signal
import subprocess
import sys
import time

import pytest

from arrive.learning.checkpoint import load_checkpoint
from arrive.learning.logs import read_log
from arrive.startup import INTERRUPTED, interrupt_again, leave_at_once
from tiny_runs import train_words

PROGRAM = """
import os, sys
from arrive.__main__ import main
os.write(1, b"up")
main()
"""
TRAIN = train_words(1_000_000)
PATIENCE_S = 300.0


def start(folder, *words):
    """The program, once Python itself has started and come to its first lines: before that it is not ours to handle."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert os.read(process.stdout.fileno(), 2) == b"up"
    return process


def end(process) -> tuple[int, str]:
    """Press Ctrl-C and wait.

    Python gives the signal back to the system in its last moments. A program that had printed everything and ends
    by the signal then counts as done.
    """
    process.send_signal(signal.SIGINT)
    try:
        out, err = (text.decode() for text in process.communicate(timeout=PATIENCE_S))
    finally:
        process.kill()  # a training that did not hear it would go on for days
    assert "Traceback" not in out + err, err
    assert "KeyboardInterrupt" not in out + err, err
    assert "Exception ignored" not in out + err, err
    done = process.returncode == -signal.SIGINT and out.endswith("\n") and not err
    return 0 if done else process.returncode, err


@pytest.mark.parametrize("delay_s", [0.0, 0.03, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2])
def test_a_training_that_is_interrupted_at_any_moment(tmp_path, delay_s):
    process = start(tmp_path, *TRAIN)
    time.sleep(delay_s)
    code, err = end(process)
    assert code == INTERRUPTED
    assert err.startswith("arrive: interrupted")
    assert err.count("\n") == 1
    if (tmp_path / "run" / "checkpoint.pt").exists():  # it was training: the iteration was finished and saved
        saved = load_checkpoint(tmp_path / "run" / "checkpoint.pt")[1]["iteration"]
        assert saved == len(read_log(tmp_path / "run")["iteration"]) > 0
        assert not (tmp_path / "run" / "run.lock").exists()


@pytest.mark.parametrize(
    "words",
    [("list",), ("eval", "nowhere"), ("verify", "nowhere.onnx"), ("play", "--seconds", "60")],
    ids=lambda w: w[0],
)
@pytest.mark.parametrize("delay_s", [0.0, 0.3, 1.0])
def test_other_commands_too(tmp_path, words, delay_s):
    process = start(tmp_path, *words)
    time.sleep(delay_s)
    code, err = end(process)
    # 0 and 1 where it had ended before, and 0 for the page, which runs until Ctrl-C.
    assert code == INTERRUPTED if "interrupted" in err else code in (0, 1)
    assert err.count("\n") <= 1


def test_a_second_ctrl_c_is_one_line_too(tmp_path):
    """Whenever it comes: while it saves, or while libraries end."""
    process = start(tmp_path, *TRAIN)
    deadline = time.monotonic() + PATIENCE_S
    while not (tmp_path / "run" / "checkpoint.pt").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    code, _ = end(process)
    assert code in (INTERRUPTED, -signal.SIGINT), "the latter in Python's last moments"
    load_checkpoint(tmp_path / "run" / "checkpoint.pt")


def test_only_the_handler_of_startup_is_replaced():
    def mine(number, frame):
        raise AssertionError

    before = signal.signal(signal.SIGINT, mine)
    try:
        interrupt_again()
        assert signal.getsignal(signal.SIGINT) is mine
        leave_at_once()
        interrupt_again()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("words", [("list", "config"), ("list",), ("--help",), ("train", "--help"), ("--version",)])
def test_a_reader_that_has_gone_is_no_error(words):
    """As with `arrive list config | head -1`."""
    process = subprocess.Popen(
        [sys.executable, "-m", "arrive", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 0
