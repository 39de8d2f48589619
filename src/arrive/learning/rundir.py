"""A run's folder: what was asked, by which code, and what came of it."""

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from arrive import __version__
from arrive.config import Config, from_dict, to_dict
from arrive.errors import ArriveError

CONFIG_NAME = "config.json"
RUNS = Path("runs")


def commit() -> str:
    """The commit of the code that is running, with `+` if it was changed, or the version outside a checkout."""
    folder = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        return git("rev-parse", "--short=12", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.CalledProcessError):
        return f"version {__version__}"


def new_run_folder(config: Config, folder: Path | None) -> Path:
    """Make the folder of a new run; without a name given, one from terrain, preset, seed and time.

    Raises:
        ArriveError: it cannot be written, or already holds a run.
    """
    if folder is None:
        terrain = "-".join(config.terrain.families) if len(config.terrain.families) < 4 else "mixed"
        folder = RUNS / f"{time.strftime('%Y%m%d-%H%M%S')}-{terrain}-{config.task.name}-{config.preset}-{config.seed}"
    if (folder / CONFIG_NAME).exists():
        raise ArriveError(f"{folder} already holds a run; continue it with --resume {folder}, or choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError("permission denied")
    except OSError as error:
        raise ArriveError(f"cannot write to the run folder {folder}: {error}") from error
    return folder


def write_config(folder: Path, config: Config, before: int = 0) -> None:
    """Write the resolved configuration with commit, command and seed, before training starts.

    Args:
        before: policy steps of the runs that this one begins from.
    """
    content = {
        "config": to_dict(config),
        "commit": commit(),
        "command": shlex.join(["arrive", *sys.argv[1:]]),
        "seed": config.seed,
        "samples_before": before,
    }
    try:
        (folder / CONFIG_NAME).write_text(json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise ArriveError(f"cannot write to the run folder {folder}: {error}") from error


def read_config(folder: Path) -> tuple[Config, dict[str, Any]]:
    """The configuration a run was made with, and the whole record.

    Raises:
        ArriveError: the folder holds no run, or its configuration is not readable.
    """
    path = folder / CONFIG_NAME
    if not path.is_file():
        raise ArriveError(f"{folder} is not a run folder: it has no {CONFIG_NAME}")
    try:
        content = json.loads(path.read_text())
        return from_dict(Config, content["config"]), content
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ArriveError(f"cannot read {path}: {error!r}") from error


def samples_before(record: dict[str, Any]) -> int:
    """Policy steps of the runs that a run began from; 0 also where its record is too old to say."""
    return int(record.get("samples_before", 0))
