"""What the package imports: no circle of files or packages, and nothing that pyproject.toml does not require.

Imports in functions and imports for types are included.
"""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

import arrive

ROOT = Path(arrive.__file__).parent.parent
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in (ROOT / "arrive").rglob("*.py")
}
"""Path of every module by name."""
Graph = dict[str, set[str]]
DISTRIBUTIONS = {
    "stable_baselines3": "stable-baselines3",
    "PIL": "pillow",
    "mujoco": "mujoco-core",
    "rsl_rl": "rsl-rl-lib",
    "warp": "warp-lang",
}
"""Names of distributions that differ from their module's."""
WITHOUT_DEPENDENCIES = {"mujoco_warp"}
"""Installed with `pip install --no-deps`, which pyproject.toml cannot say."""


def imports_of(tree: ast.AST) -> set[str]:
    """The modules of this project that a module imports, wherever it does."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in FILES else node.module for name in names}
    return found & FILES.keys()


def graph_of_files() -> Graph:
    return {name: imports_of(ast.parse(path.read_text())) - {name} for name, path in FILES.items()}


def graph_of_packages(files: Graph) -> Graph:
    """A package, or a module beside the packages, imports what any of its files does."""
    package = {name: ".".join(name.split(".")[:2]) for name in files}
    graph: Graph = {part: set() for part in package.values()}
    for name, imported in files.items():
        graph[package[name]] |= {package[other] for other in imported} - {package[name]}
    return graph


def circle_in(graph: Graph) -> list[str]:
    """One circle, or nothing: what is left after all that imports nothing that is left was taken away."""
    left = dict(graph)
    while free := [name for name, imported in left.items() if not imported & left.keys()]:
        for name in free:
            del left[name]
    way: list[str] = []
    name = next(iter(left), None)
    while name is not None and name not in way:
        way.append(name)
        name = min(left[name] & left.keys())
    return way[way.index(name) :] if way else []


def test_a_circle_is_found():
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == ["b", "c"]
    assert circle_in({"a": {"b"}, "b": set(), "c": {"a", "b"}}) == []


def test_imports_in_functions_and_for_types_are_seen():
    code = """
import arrive.env
def f():
    from arrive.terrain import tile
if TYPE_CHECKING:
    from arrive.config import Config
"""
    assert imports_of(ast.parse(code)) == {"arrive.env", "arrive.terrain.tile", "arrive.config"}


@pytest.mark.parametrize("of", ["files", "packages"])
def test_there_is_no_circle(of):
    graph = graph_of_files() if of == "files" else graph_of_packages(graph_of_files())
    assert sum(map(len, graph.values())) > 50
    circle = circle_in(graph)
    assert not circle, " -> ".join(circle)


def modules_of(tree: ast.AST) -> set[str]:
    """The top-level names of all modules that a module imports."""
    nodes = list(ast.walk(tree))
    plain = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names = plain | {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.partition(".")[0] for name in names}


def test_every_import_is_a_declared_dependency():
    """A package that only a dependency requires can disappear with that dependency's next version."""
    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    declared = {re.match(r"[\w-]+", line)[0] for line in lines}
    imported = set.union(*(modules_of(ast.parse(path.read_text())) for path in FILES.values()))
    foreign = imported - sys.stdlib_module_names - {"arrive"} - WITHOUT_DEPENDENCIES
    assert {"numpy", "msgspec"} <= foreign
    assert {DISTRIBUTIONS.get(name, name) for name in foreign} <= declared
