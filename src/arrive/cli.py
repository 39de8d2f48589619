"""The command line: `arrive train`, `eval`, `report`, `play`, `drive`, `export`, `list` and more."""

import importlib
import os
import runpy
import sys
from typing import Annotated

import tyro

from arrive import __version__
from arrive.commands.actuator import Action, Actuator
from arrive.commands.known import known
from arrive.commands.limits import check_limits, check_outputs
from arrive.commands.options import (
    Bench,
    Drive,
    Energy,
    Eval,
    Export,
    Gait,
    List,
    Play,
    Report,
    Showreel,
    Train,
    Verify,
)
from arrive.commands.parsing import NUMBERS, unknown_command
from arrive.errors import ArriveError, Interrupted, shown
from arrive.neighbours import wait_considerately
from arrive.plugins import blamed, import_module, import_packages
from arrive.startup import INTERRUPTED, interrupt_again

DEBUG = "--debug"
"""Option of every command: show tracebacks."""
IMPORT = "--import"
"""Option of every command: import a module that registers robots, terrains or other parts."""
VERSION = "--version"
USAGE = 2
"""Exit status after a command line that cannot be read, as tyro's."""
GRAPHICS = ("egl", "osmesa", "glfw", "glx", "disable")
"""Values of MUJOCO_GL to suggest."""
ALSO_GRAPHICS = ("", "enable", "enabled", "on", "true", "1", "disabled", "off", "false", "0", "wgl", "cgl")
"""Other values that MuJoCo takes."""
DESCRIPTION = (
    "Train, measure and run policies that bring a legged robot to a target by a given time. `arrive COMMAND --help` "
    f"explains a command. {DEBUG} shows tracebacks. {IMPORT} FILE.py adds your own robots, terrains and more. "
    f"{VERSION} prints the version."
)

AnyCommand = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Eval, tyro.conf.subcommand("eval")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Energy, tyro.conf.subcommand("energy")]
    | Annotated[Gait, tyro.conf.subcommand("gait")]
    | Annotated[Drive, tyro.conf.subcommand("drive")]
    | Annotated[Play, tyro.conf.subcommand("play")]
    | Annotated[Showreel, tyro.conf.subcommand("showreel")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Actuator, tyro.conf.subcommand("actuator")]
    | Annotated[List, tyro.conf.subcommand("list")]
)


SETTABLE = ("train", "bench")
"""Commands that accept --set. Their help lists all fields of the configuration."""


def main(arguments: list[str] | None = None) -> None:
    """Run a command.

    An error prints one line on standard error and exits with 1; --debug adds the traceback. An interrupt before the
    work is done exits with `INTERRUPTED`.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    debug = DEBUG in arguments
    words = [word for word in arguments if word != DEBUG]
    if words == [VERSION]:
        print(f"arrive {__version__}")
        return
    imports, words = _imports(words)
    words = words or ["--help"]
    if error := unknown_command(words, AnyCommand) or _unknown_action(words):
        print(f"arrive: {shown(str(error))}", file=sys.stderr)
        sys.exit(USAGE)
    try:
        with NUMBERS:
            command = tyro.cli(AnyCommand, prog="arrive", description=DESCRIPTION, args=words)
    except SystemExit as stop:
        if not stop.code and words[0] in SETTABLE:
            _show_fields()
        raise
    try:
        _check_empty(words)
        _check_graphics()
        check_limits(command)
        check_outputs(command)
        for source in imports:
            import_module(source)
        import_packages()
        _run(command)
    except (Exception, KeyboardInterrupt) as error:
        if debug and not isinstance(error, Interrupted):
            raise
        print(f"arrive: {shown(_one_line(error))}", file=sys.stderr)
        sys.exit(INTERRUPTED if isinstance(error, Interrupted | KeyboardInterrupt) else 1)


def _unknown_action(words: list[str]) -> ArriveError | None:
    """The error for a subcommand that there is not; otherwise None."""
    return unknown_command(words[1:], Action, words[0]) if words[0] == "actuator" else None


def _show_fields() -> None:
    """Print the fields that --set can change, below the command's help."""
    print()
    print(known()["config"], end="")


def _check_empty(words: list[str]) -> None:
    """Refuse empty arguments. An unset shell variable leaves one, and as a path it means the current folder.

    Raises:
        ArriveError: an argument is empty, or an option has none.
    """
    for before, word in zip(["arrive", *words], words, strict=False):
        if not word.partition("=")[2 if word.startswith("--") and "=" in word else 0].strip():
            raise ArriveError(f"the argument after {before!r} is empty; is a variable not set?")
        if word == "--" and before.startswith("--"):
            raise ArriveError(f"{before} has no value")


def _check_graphics() -> None:
    """Check MUJOCO_GL, because MuJoCo cannot be imported with a value that it does not know.

    Raises:
        ArriveError: it has such a value.
    """
    value = os.environ.get("MUJOCO_GL", "").lower().strip()
    if value not in GRAPHICS + ALSO_GRAPHICS:
        raise ArriveError(f"the environment variable MUJOCO_GL must be {', '.join(GRAPHICS)} or unset, not {value!r}")


def _imports(words: list[str]) -> tuple[list[str], list[str]]:
    """The modules that --import names, and the other arguments."""
    sources, others, words = [], [], list(words)
    while words:
        word = words.pop(0)
        if word == IMPORT and words:
            sources.append(words.pop(0))
        elif word.startswith(f"{IMPORT}="):
            sources.append(word.partition("=")[2])
        else:
            others.append(word)
    return sources, others


def _one_line(error: BaseException) -> str:
    """An error as one line for the user."""
    if isinstance(error, ArriveError):
        return str(error)
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, OSError):
        return f"{error.strerror or error}" + (f": {error.filename}" if error.filename else "")
    if isinstance(error, MemoryError):
        return "not enough memory for this; choose fewer robots (--num-envs), steps or episodes"
    fault = f"{type(error).__name__}: {' '.join(str(error).split()):.300}"
    if where := blamed(error):
        return f"{where}: {fault}. {DEBUG} shows the traceback."
    return f"unexpected {fault}. {DEBUG} shows where; please report it."


def _run(command: AnyCommand) -> None:
    if getattr(command, "threads", 1) != 1:
        wait_considerately()
    module, function = {
        Train: ("training", "train"),
        Eval: ("evaluation", "run_eval"),
        Report: ("evaluation", "report"),
        Energy: ("energy", "energy"),
        Gait: ("gait", "gait"),
        Drive: ("drive", "run_drive"),
        Play: ("play", "run_play"),
        Showreel: ("showreel", "showreel"),
        Export: ("export", "export"),
        Verify: ("export", "verify_file"),
        Bench: ("bench", "bench"),
        Actuator: ("actuator", "actuator"),
        List: ("names", "list_names"),
    }[type(command)]
    # Imported here so that help and misspelt options are fast.
    run = getattr(importlib.import_module(f"arrive.commands.{module}"), function)
    interrupt_again()
    run(command)


if __name__ == "__main__":
    # As the program `arrive`, whose output never raises.
    runpy.run_module("arrive", run_name="__main__")
