"""The run folder: its configuration, the version of the code, and the lock for writing."""

import contextlib
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from arrive import __version__
from arrive.config import Config, saved_config, to_dict
from arrive.errors import ArriveError
from arrive.files import cannot_write, is_unfinished, read_json, remove_unfinished, write_bytes, write_json
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.logs import LOG_NAME, TENSORBOARD_NAME
from arrive.lock import Lock
from arrive.plugins import imported, require
from arrive.policies import CONFIG_NAME, POLICY_NAME, RUNS
from arrive.results.read import check_result

LOCK_NAME = "run.lock"
MOTOR_NAME = "motor.safetensors"
"""File name of the run's own copy of its actuator network."""


def commit() -> str:
    """The commit of the running code, with `+` if files are modified. Outside a checkout it is unknown.

    A package that is installed, or copied, into a checkout of something else is outside: git does not know its files.
    """
    folder = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)
        return git("rev-parse", "--short=12", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.CalledProcessError):
        return f"unknown (version {__version__}, not in a git checkout)"


def new_run_folder(config: Config, folder: Path | None) -> Path:
    """Make the folder of a new run. Without a given folder, its name has time, terrain, task, preset and seed.

    A folder left by a start that was interrupted before the first checkpoint can be used again.

    Raises:
        ArriveError: the folder cannot be written, or already holds a run.
    """
    try:
        if folder is None:
            return _new_folder(config)
        check_free(folder)
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError("permission denied")
    except OSError as error:
        raise ArriveError(f"cannot write to the run folder {folder or RUNS}: {error.strerror or error}") from error
    return folder


def check_free(folder: Path) -> None:
    """Check that a folder holds neither a run nor the user's own files, which a run might replace.

    Raises:
        ArriveError: it does.
    """
    for name in (CHECKPOINT_NAME, POLICY_NAME, LOG_NAME):
        if (folder / name).exists():
            raise ArriveError(
                f"{folder} already holds a run ({name}); continue it with --resume {folder}, or choose another folder"
            )
    foreign = sorted(path.name for path in folder.iterdir() if not _of_a_start(path)) if folder.is_dir() else ()
    if foreign:
        raise ArriveError(f"{folder} holds other files, such as {foreign[0]}; choose a new folder for the run")


def _of_a_start(path: Path) -> bool:
    """Whether a start that was interrupted before the first checkpoint left this file."""
    if path.name == CONFIG_NAME:
        try:
            return read_json(path).keys() >= {"config", "command", "commit"}
        except ArriveError:
            return False
    return path.name in (LOCK_NAME, MOTOR_NAME, TENSORBOARD_NAME) or is_unfinished(path)


def _new_folder(config: Config) -> Path:
    """Make a new folder under RUNS. Two runs started in the same second get different folders."""
    terrain = "-".join(config.terrain.families) if len(config.terrain.families) < 4 else "mixed"
    name = f"{time.strftime('%Y%m%d-%H%M%S')}-{terrain}-{config.task.name}-{config.preset}-{config.seed}"
    folder, number = RUNS / name, 1
    while folder.exists() or not _made(folder):
        number += 1
        folder = RUNS / f"{name}-{number}"
    return folder


def _made(folder: Path) -> bool:
    """Make a folder. Returns False if it already exists."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        folder.mkdir()
    except FileExistsError:
        return False
    return True


@contextlib.contextmanager
def owned(folder: Path) -> Iterator[Lock]:
    """Hold the lock of a run folder, and remove incomplete files that a killed process left.

    A folder that is empty at the end, because the start failed, is removed too.

    Raises:
        ArriveError: another process holds the lock.
    """
    try:
        with Lock(folder / LOCK_NAME, f"the run in {folder}") as lock:
            try:
                remove_unfinished(folder)
            except OSError as error:
                raise cannot_write(folder, error) from error
            yield lock
    finally:
        with contextlib.suppress(OSError):  # where it holds a run
            folder.rmdir()


def write_config(folder: Path, config: Config, before: int = 0) -> None:
    """Write the resolved configuration with commit, command and seed, just before the first checkpoint.

    The actuator network that it names is copied first, so that the folder has everything that the run needs.

    Args:
        before: policy steps of the runs that this one started from.

    Raises:
        ArriveError: the folder cannot be written.
    """
    content = {
        "config": to_dict(config),
        "commit": commit(),
        "command": shlex.join(["arrive", *sys.argv[1:]]),
        "seed": config.seed,
        "samples_before": before,
        "imports": imported(),
    }
    if config.physics.motor_file:
        write_bytes(folder / MOTOR_NAME, Path(config.physics.motor_file).read_bytes())
    write_json(folder / CONFIG_NAME, content)


def _record(folder: Path) -> dict[str, Any]:
    """A run's record as it is in the file; empty if the folder has none."""
    path = folder / CONFIG_NAME
    return read_json(path) if path.is_file() else {}


def require_imports(folder: Path) -> None:
    """Check that the plugin modules recorded in a run folder are imported.

    Raises:
        ArriveError: one is not imported; the message says how to import it.
    """
    modules = _record(folder).get("imports", {})
    if isinstance(modules, dict):
        require({str(name): str(source) for name, source in modules.items()}, folder)


def with_own_motor(config: Config, folder: Path) -> Config:
    """The configuration of a run, with the actuator network replaced by the folder's own copy."""
    if not config.physics.motor_file or not (folder / MOTOR_NAME).is_file():
        return config
    return replace(config, physics=replace(config.physics, motor_file=str(folder / MOTOR_NAME)))


def read_config(folder: Path) -> tuple[Config, dict[str, Any]]:
    """The configuration of a run, and the whole record.

    Args:
        folder: the run folder, or its configuration file.

    Raises:
        ArriveError: the folder does not hold a run, or its configuration is not readable.
    """
    path = folder if folder.is_file() else folder / CONFIG_NAME
    try:
        if not path.is_file():
            raise ArriveError(f"{folder} is not a run folder: it has no {CONFIG_NAME}")
    except OSError as error:
        raise ArriveError(f"cannot read {path}: {error.strerror or error}") from error
    content = read_json(path)
    check_result(content, "record", path, "Restore the file from a copy.")
    require_imports(folder)
    config = saved_config(content["config"], path)
    # Fields that an older version did not write get their defaults.
    return with_own_motor(config, folder), content | {"config": to_dict(config)}


def recorded_commit(folder: Path) -> str | None:
    """The commit in a run's record, or None without a record that has one."""
    commit = _record(folder).get("commit")
    return commit if isinstance(commit, str) else None


def samples_before(record: dict[str, Any]) -> int:
    """Policy steps of the runs that a run started from."""
    return int(record.get("samples_before", 0))
