"""Fields of configurations: ranges, documentation and checks.

A configuration is a frozen dataclass, and its fields may be such dataclasses too. The range of a field is part of its
type, `Annotated[float, Range(0.0, 1.0)]`. The string below the field is its documentation, with the unit in brackets.
If a range depends on another field, the dataclass has a method `rules`. A dataclass with a class variable `kinds` is
the base class of several, which are told apart by their field `name`.
"""

import ast
import dataclasses
import inspect
import itertools
import json
import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from arrive.errors import ArriveError


@dataclass(frozen=True)
class Range:
    """The valid range of a number, or of each number in a list. NaN and infinity are never valid."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    """Whether the number must be above `low`, not equal to it."""
    below: bool = False
    """Whether the number must be below `high`, not equal to it."""

    def holds(self, value: float) -> bool:
        """Whether the number is in the range."""
        if isinstance(value, float) and not math.isfinite(value):  # isfinite raises for very large integers
            return False
        enough = value > self.low if self.above else value >= self.low
        return enough and (value < self.high if self.below else value <= self.high)

    @property
    def meaningful(self) -> "Range":
        """The range without the limits that are there for the arithmetic, such as float32's."""
        low = self.low if self.low > -LARGEST else -math.inf
        high = self.high if self.high < LARGEST else math.inf
        return replace(self, low=low, high=high)

    def required_of(self, value: Any) -> "Range":
        """The limits to name in an error about a number, or a tuple of numbers."""
        numbers = [item for item in (value if isinstance(value, tuple) else (value,)) if isinstance(item, float | int)]
        technical = any(self.meaningful.holds(item) and not self.holds(item) for item in numbers)
        return self if technical else self.meaningful

    def __str__(self) -> str:
        low = "" if self.low == -math.inf else f"{'above' if self.above else 'at least'} {_figure(self.low)}"
        high = "" if self.high == math.inf else f"{'below' if self.below else 'at most'} {_figure(self.high)}"
        if low and high and not (self.above or self.below):
            return f"{_figure(self.low)} to {_figure(self.high)}"
        return " and ".join(part for part in (low, high) if part) or "any finite number"


def _figure(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


LARGEST = 1e6
"""Largest length, speed, time, weight or gain: float32 can hold a sum of their squares. Documentation omits it."""
Positive = Annotated[float, Range(0.0, LARGEST, above=True)]
NotNegative = Annotated[float, Range(0.0, LARGEST)]
NotPositive = Annotated[float, Range(-LARGEST, 0.0)]
Share = Annotated[float, Range(0.0, 1.0)]
AtLeastOne = Annotated[int, Range(1, 2**31 - 1)]
SEED = Range(0, 2**32 - 1)
"""Of a seed: what NumPy and torch both take."""
Interval = tuple[float, float]
"""Two numbers, the smaller first."""


class Rule(NamedTuple):
    """A condition on a field that depends on other fields."""

    field: str
    must: str
    holds: bool


class FieldInfo(NamedTuple):
    """One field, for documentation."""

    path: str
    value: Any
    unit: str
    range: str
    meaning: str


def hints_of(kind: type) -> dict[str, Any]:
    """The type of every field, including its range."""
    hints = get_type_hints(kind, include_extras=True)
    return {row.name: hints[row.name] for row in dataclasses.fields(kind)}


def is_interval(hint: Any) -> bool:
    """Whether a field is a pair of numbers, the smaller first."""
    return get_origin(hint) is tuple and get_args(hint) == (float, float)


def check_fields(config: Any) -> None:
    """Check that every field is in its range.

    Raises:
        ArriveError: lists every field that is out of range, with its value and the range.
    """
    problems = [f"{path} must be {must}, not {_shown(value)}" for path, value, must in problems_of(config)]
    if problems:
        raise ArriveError("; ".join(problems))


def _shown(value: Any) -> str:
    return json.dumps(value) if isinstance(value, tuple | bool) else repr(value)


def problems_of(config: Any, where: str = "") -> Iterator[tuple[str, Any, str]]:
    """(path, value, required range) of every field out of range. Rules are tested only if all ranges are valid."""
    bad = False
    for name, hint in hints_of(type(config)).items():
        value, path = getattr(config, name), f"{where}{name}"
        if dataclasses.is_dataclass(value):
            below = list(problems_of(value, f"{path}."))
            bad = bad or bool(below)
            yield from below
        elif (must := _out_of_range(hint, value)) is not None:
            bad = True
            yield path, value, must
    if bad or not hasattr(config, "rules"):
        return
    for rule in config.rules():
        if not rule.holds:
            value = config
            for name in rule.field.split("."):
                value = getattr(value, name)
            yield f"{where}{rule.field}", value, rule.must


def _out_of_range(hint: Any, value: Any) -> str | None:
    """The required range of a value if it is out of range, else None."""
    base, limits = split_range(hint)
    if isinstance(value, tuple):
        numbers = [item for item in value if isinstance(item, float | int)]
        fine = bool(value) and all(limits.holds(item) for item in numbers)
        if is_interval(base):
            fine = fine and value[0] <= value[1]
        return None if fine else _words(base, limits.required_of(value))
    if isinstance(value, float | int) and not isinstance(value, bool):
        return None if limits.holds(value) else _words(base, limits.required_of(value))
    return None


def _words(base: Any, limits: Range) -> str:
    """The range of a field in words."""
    if get_origin(base) is tuple:
        if limits == Range():
            return "two numbers, the smaller first" if is_interval(base) else "a list of at least one"
        return f"{'two numbers, the smaller first' if is_interval(base) else 'a list of at least one number'}, {limits}"
    if get_origin(base) is Literal:
        return ", ".join(map(str, get_args(base)))
    return {bool: "true or false", str: ""}.get(base, str(limits))


def split_range(hint: Any) -> tuple[Any, Range]:
    """A field's type without its range, and the range."""
    if get_origin(hint) is Annotated:
        base, *notes = get_args(hint)
        return base, next(note for note in notes if isinstance(note, Range))
    return hint, Range(-LARGEST, LARGEST)


def rows(config: Any, where: str = "") -> Iterator[FieldInfo]:
    """Every field of a configuration with its value."""
    kind: type = type(config)
    words = documentation(kind)
    meanings = {row.name: row.metadata.get("meaning", "") for row in dataclasses.fields(config)}
    for name, hint in hints_of(kind).items():
        value = getattr(config, name)
        if not dataclasses.is_dataclass(value):
            meaning = words.get(name, "")
            base, limits = split_range(hint)
            yield FieldInfo(f"{where}{name}", value, _unit(meaning), _words(base, limits.meaningful), meaning)
            continue
        for row in rows(value, f"{where}{name}."):
            if row.path == f"{where}{name}.{getattr(value, 'MAIN', '')}":
                term = words.get(name, "")
                unit = _unit(f"{term} {row.meaning}")
                row = row._replace(unit=unit, meaning=f"{term or meanings.get(name, '')} {row.meaning}".strip())
            yield row


def _unit(meaning: str) -> str:
    """The text in the first brackets."""
    return meaning.partition("[")[2].partition("]")[0]


@cache
def documentation(kind: type) -> dict[str, str]:
    """The documentation strings below a dataclass's fields, including those of its base classes."""
    words: dict[str, str] = {}
    for owner in reversed([base for base in kind.__mro__ if dataclasses.is_dataclass(base)]):
        tree = ast.parse(textwrap.dedent(inspect.getsource(owner))).body[0]
        assert isinstance(tree, ast.ClassDef)
        for field, below in itertools.pairwise(tree.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
                words[field.target.id] = " ".join(ast.literal_eval(below.value).split())
    return words
