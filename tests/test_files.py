"""Files: written completely or not at all, and read with errors of one line."""

import errno
import os
import subprocess
import sys

import pytest

from arrive import files
from arrive.errors import ArriveError
from arrive.files import read_json, remove_unfinished, whole, write_bytes, write_json, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_written_is_read_back_and_its_folder_made(tmp_path):
    path = tmp_path / "new" / "folder" / "result.json"
    write_json(path, {"a": [1, 2.5, "µ"]})
    assert read_json(path) == {"a": [1, 2.5, "µ"]}
    assert names(path.parent) == ["result.json"]
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_file_keeps_its_permissions_and_a_link_its_target(tmp_path):
    write_text(tmp_path / "kept", "old")
    (tmp_path / "kept").chmod(0o600)
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "kept").read_text() == "new"
    assert (tmp_path / "kept").stat().st_mode & 0o777 == 0o600


def test_devices_and_pipes_are_written_directly(tmp_path):
    write_text(os.devnull, "nothing")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, "through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)


class Stop(BaseException):
    """Not an Exception, as the end of a process."""


@pytest.mark.parametrize(
    ("failure", "raised"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), ArriveError),
        (ValueError("no picture"), ValueError),
        (KeyboardInterrupt(), KeyboardInterrupt),
        (Stop(), Stop),
    ],
    ids=["disk full", "writer fails", "interrupt", "exit"],
)
def test_a_failure_in_the_middle_leaves_the_old_file_whole(tmp_path, failure, raised):
    path = tmp_path / "picture.png"
    write_text(path, "old")

    def fail_half_way():
        with whole(path) as file:
            assert file.suffix == ".png", "libraries choose the format by the suffix"
            file.write_text("half")
            assert len(names(tmp_path)) == 2
            raise failure

    with pytest.raises(raised):
        fail_half_way()
    assert names(tmp_path) == ["picture.png"]
    assert path.read_text() == "old"


@pytest.mark.parametrize("function", ["replace", "fsync", "chmod"])
def test_a_full_disk_at_any_moment_is_an_error_that_says_so(tmp_path, monkeypatch, function):
    path = tmp_path / "result.json"
    write_text(path, "old")

    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(files.os, function, full)
        with pytest.raises(ArriveError, match=r"result\.json: No space left.*space"):
            write_text(path, "new")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["result.json"]


def test_a_real_limit_on_the_size_of_files_keeps_the_old_one(tmp_path):
    """RLIMIT_FSIZE binds the administrator too and stops the write in the middle, as a full disk does."""
    path = tmp_path / "result.bin"
    write_bytes(path, b"old")
    code = f"""
import pathlib, resource, signal
from arrive.errors import ArriveError
from arrive.files import write_bytes
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
try:
    write_bytes(pathlib.Path({str(path)!r}), bytes(100000))
except ArriveError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "cannot write" in done.stdout, done.stderr
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["result.bin"]


@pytest.mark.parametrize("place", ["file/run/result.json", "x" * 300, "folder"])
def test_a_place_that_cannot_be_written_is_named(tmp_path, place):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ArriveError, match=f"cannot write .*{place}"):
        write_text(tmp_path / place, "new")
    assert names(tmp_path) == ["file", "folder"]


def test_only_unfinished_files_of_a_killed_process_are_removed(tmp_path):
    """The write is killed between the first byte and the last."""
    path = tmp_path / "checkpoint.pt"
    write_text(path, "old")
    (tmp_path / ".hidden").write_text("the user's own")
    code = f"""
import os, pathlib, signal
from arrive.files import whole
with whole(pathlib.Path({str(path)!r})) as file:
    file.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == -9
    assert len(names(tmp_path)) == 3
    remove_unfinished(tmp_path)
    assert names(tmp_path) == [".hidden", "checkpoint.pt"]
    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "not JSON"),
        (b'{"a": ', "line 1"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"[1, 2]", "list"),
        (b"null", "NoneType"),
        (b"[" * 100_000, "not JSON"),
        (b'{"a": ' + b"9" * 5000 + b"}", "not JSON"),
    ],
    ids=["empty", "cut off", "binary", "list", "null", "nested", "huge number"],
)
def test_a_damaged_json_file_is_one_line(tmp_path, content, word):
    path = tmp_path / "config.json"
    path.write_bytes(content)
    with pytest.raises(ArriveError, match=rf"cannot read .*config\.json: .*{word}"):
        read_json(path)
