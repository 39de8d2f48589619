"""The lock: one holder at a time, named in the file, released when its process ends."""

import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from arrive.errors import ArriveError
from arrive.lock import Lock

HOLDER = """
import pathlib, sys, time
from arrive.lock import Lock
with Lock(pathlib.Path(sys.argv[1]), "the run"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock."""
    process = subprocess.Popen([sys.executable, "-c", HOLDER, tmp_path / "run.lock"], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_lock_names_its_holder_and_is_gone_in_the_end(tmp_path):
    path = tmp_path / "run.lock"
    with Lock(path, "the run"):
        assert json.loads(path.read_text()) == {"pid": os.getpid(), "host": socket.gethostname()}
        with pytest.raises(ArriveError, match=rf"the run is in use by process {os.getpid()}\."):
            Lock(path, "the run").acquire()
    assert not path.exists()
    with Lock(path, "the run"):
        pass


def test_a_living_process_keeps_its_lock_and_a_killed_one_loses_it(tmp_path, holder):
    lock = Lock(tmp_path / "run.lock", "the run")
    with pytest.raises(ArriveError, match=rf"in use by process {holder.pid}\..*kill {holder.pid}"):
        lock.acquire()
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert lock.path.exists(), "nothing was there to be taken over"
    with lock:
        assert json.loads(lock.path.read_text())["pid"] == os.getpid()


def test_a_reused_process_id_does_not_keep_a_lock(tmp_path):
    """The owner died, and its process id was given to somebody else: here to ourselves."""
    path = tmp_path / "run.lock"
    path.write_text(json.dumps({"pid": os.getpid(), "host": socket.gethostname()}))
    with Lock(path, "the run"):
        pass


def test_a_lock_of_another_host_is_never_taken(tmp_path):
    path = tmp_path / "run.lock"
    path.write_text(json.dumps({"pid": 77, "host": "elsewhere"}))
    with pytest.raises(ArriveError, match=r"process 77 on elsewhere\. If that process has ended, delete .*run\.lock"):
        Lock(path, "the run").acquire()
    assert json.loads(path.read_text())["host"] == "elsewhere"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b'{"pid": "x"}',
        b"[" * 4096,
        b'{"pid": 1e999, "host": "x"}',
        b'{"pid": ' + b"9" * 4000 + b', "host": "x"}',
        b'{"pid": "1", "host": "x"}',
        b'{"pid": 1, "host": null}',
        b'{"pid": 1, "host": ""}',
        b'{"pid": 1, "host": "' + b"x" * 300 + b'"}',
    ],
    ids=range(12),
)
def test_an_unreadable_lock_that_nobody_holds_is_taken(tmp_path, content):
    """Its owner was killed before it had written its name, or the file was damaged."""
    path = tmp_path / "run.lock"
    path.write_bytes(content)
    with Lock(path, "the run"):
        assert json.loads(path.read_text())["pid"] == os.getpid()


def test_a_child_process_that_inherits_the_lock_keeps_it(tmp_path):
    lock = Lock(tmp_path / "run.lock", "the run")
    lock.acquire()
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[lock.handle])
    os.close(lock.handle)  # as when we are killed
    try:
        with pytest.raises(ArriveError, match="in use"):
            Lock(lock.path, "the run").acquire()
    finally:
        child.communicate(b"\n", timeout=60)
    with Lock(lock.path, "the run"):
        pass


@pytest.mark.parametrize("replaced", [False, True])
def test_the_holder_notices_that_its_folder_was_removed(tmp_path, replaced):
    with Lock(tmp_path / "run.lock", "the run") as lock:
        lock.check()
        lock.path.unlink()
        if replaced:
            lock.path.write_text("another's")
        with pytest.raises(ArriveError, match=r"run\.lock was removed while the run was in use"):
            lock.check()
    assert lock.path.exists() == replaced, "another's lock was removed"


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ArriveError, match=r"cannot write .*nowhere/run\.lock"):
        Lock(tmp_path / "nowhere" / "run.lock", "the run").acquire()
