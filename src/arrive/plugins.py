"""Robots, terrains and more from your own module: `--import my_module.py`, or an installed package.

A module registers its parts when it is imported. A package that lists its modules in the entry-point group
`arrive.plugins` needs no `--import`.
"""

import importlib
import importlib.util
import re
import sys
import traceback
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from arrive.errors import ArriveError

GROUP = "arrive.plugins"
"""Entry-point group of packages whose modules are imported by every command."""

MODULE = re.compile(r"\w+(\.\w+)*")
"""The dotted name of a module."""

_imported: dict[str, str] = {}


def imported() -> dict[str, str]:
    """The imported plugin modules: name and source."""
    return dict(_imported)


def import_options() -> list[str]:
    """The options by which another command imports the same modules. Those of packages need none."""
    return [word for name, source in _imported.items() if _was_named(name, source) for word in ("--import", source)]


def _was_named(name: str, source: str) -> bool:
    """Whether a module came by --import, not from an installed package."""
    return source.endswith(".py") or source == name


def import_module(source: str) -> ModuleType:
    """Import a plugin module. Importing it a second time does not run it again.

    Args:
        source: a file that ends in .py, or the dotted name of an installed module.

    Raises:
        ArriveError: there is no such module, or it failed; the message names the module and the fault.
    """
    path = Path(source)
    name = path.stem if path.suffix == ".py" else source
    if name in _imported:
        return sys.modules[name]
    if path.suffix == ".py" and not path.is_file():
        raise ArriveError(f"--import {source}: there is no such file")
    if path.suffix != ".py" and not MODULE.fullmatch(source):
        raise ArriveError(f"--import {source!r}: name a file that ends in .py, or an installed module as a.b")
    if path.suffix == ".py" and name in sys.modules:
        raise ArriveError(f"--import {source}: a module named {name!r} is already loaded; rename the file")
    try:
        module = _run_file(name, path) if path.suffix == ".py" else importlib.import_module(source)
    except ArriveError as error:
        raise ArriveError(f"--import {source}: {error}") from error
    except SystemExit as stop:
        raise ArriveError(f"--import {source} failed: the module ends the program (SystemExit: {stop.code})") from stop
    except Exception as error:  # whatever a user's module raises
        raise ArriveError(f"--import {source} failed: {type(error).__name__}: {error}") from error
    _imported[name] = str(path.resolve()) if path.suffix == ".py" else source
    return module


def _run_file(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None  # a file that ends in .py has both
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def import_packages() -> None:
    """Import the modules that installed packages list in the entry-point group `arrive.plugins`.

    Raises:
        ArriveError: one of them failed; the message names its package.
    """
    for point in entry_points(group=GROUP):
        if point.value in _imported:
            continue
        package = point.dist.name if point.dist else point.name
        try:
            point.load()
        except Exception as error:  # whatever a package's module raises
            raise ArriveError(
                f"the package {package} cannot be loaded (entry point {point.name!r} of {GROUP}): "
                f"{type(error).__name__}: {error}. Fix or uninstall it."
            ) from error
        _imported[point.value] = f"package {package}"


def blamed(error: BaseException) -> str:
    """Where an error arose in an imported module, or else which modules may be at fault; empty if there are none."""
    files = {sys.modules[name].__file__: name for name in _imported if name in sys.modules}
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in files:
            return f"{frame.filename}, line {frame.lineno}"
    return f"perhaps in {', '.join(_imported)}" if _imported else ""


def require(modules: dict[str, str], whose: Path) -> None:
    """Check that the plugin modules of a run are imported. They are never imported from the run's record alone.

    Raises:
        ArriveError: one is not imported; the message says how to import it.
    """
    for name, source in modules.items():
        if name not in _imported:
            option = f"--import {source}" if _was_named(name, source) else f"the {source}"
            raise ArriveError(f"{whose} needs the module {name!r}: add {option}")
