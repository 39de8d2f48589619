"""Writes docs/deployment-reference.md from the signatures and docstrings of `arrive.deployment`.

python scripts/deployment_reference.py           # writes
python scripts/deployment_reference.py --check   # exit status 1 where it is not up to date
"""

import ast
import dataclasses
import inspect
import itertools
import re
import textwrap
import types
from pathlib import Path
from typing import Any

from pages import write_or_check

import arrive.deployment
from arrive.deployment.opening import open_policy
from arrive.deployment.policy_file import PolicyFile
from arrive.policies import DEFAULT
from arrive.terms import TERMS

PAGE = Path(__file__).parent.parent / "docs" / "deployment-reference.md"
HEAD = """# Reference of `arrive.deployment`

Made from the code by `python scripts/deployment_reference.py`; change the docstrings, not this page. Names end in the
frame they are in: `_w` the world (level, keeps still, z up), `_b` the base (x forward, y left, z up). Units stand in
brackets. How these belong together is in [deployment.md](deployment.md).
"""


def page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for name in arrive.deployment.__all__:
        parts.append(f"## `{name}`\n\n{describe(name, getattr(arrive.deployment, name))}")
    parts.append(observation(open_policy(DEFAULT)))
    return "\n".join(parts)


def observation(policy: PolicyFile) -> str:
    """The terms of a policy's observation, and their positions in it."""
    rows = [
        f"| {term.start}:{term.stop} | {term.name} | {TERMS[term.name].meaning} | {term.unit} | {term.frame} | "
        f"{term.scale:g} |"
        for term in policy.terms
    ]
    whose = f"Of the policy `{DEFAULT}` ({policy.robot.name}, task `{policy.task.name}`):"
    head = f"## The network's observation\n\n{whose}\n\n| slice | name | meaning | unit | frame | scale |"
    return "\n".join([head, "|---|---|---|---|---|---|", *rows, ""])


def describe(name: str, thing: Any) -> str:
    """Signature, docstring and parts of a class, a function or a union of classes."""
    if isinstance(thing, types.UnionType):
        return f"```python\n{name} = {' | '.join(kind.__name__ for kind in thing.__args__)}\n```\n"
    if inspect.isfunction(thing):
        return function(name, thing)
    parts = [f"```python\n{name}{signature(thing, of_class=True)}\n```\n", prose(thing)]
    if dataclasses.is_dataclass(thing):
        parts.append(field_table(thing))
    else:
        parts.append(prose(thing.__init__))
    parts += [method(thing, member) for member in vars(thing) if not member.startswith("_")]
    return "\n".join(part for part in parts if part)


def method(kind: type, name: str) -> str:
    """A public method; empty for other members."""
    member = inspect.getattr_static(kind, name)
    if isinstance(member, property):
        return f"### `{kind.__name__}.{name}`\n\n{prose(member.fget)}"
    if isinstance(member, classmethod | staticmethod):
        return f"### `{kind.__name__}.{name}`\n\n{function(f'{kind.__name__}.{name}', member.__func__)}"
    return f"### `{kind.__name__}.{name}`\n\n{function(name, member)}" if inspect.isfunction(member) else ""


def function(name: str, call: Any) -> str:
    return f"```python\n{name}{signature(call)}\n```\n\n{prose(call)}"


def signature(thing: Any, of_class: bool = False) -> str:
    """Arguments with types and defaults, without `self`; one per line if they do not fit into one line."""
    found = inspect.signature(thing)
    rows = [argument(row) for name, row in found.parameters.items() if name not in ("self", "cls")]
    returned = found.return_annotation
    end = "" if of_class or returned is found.empty else f" -> {type_name(returned)}"
    line = f"({', '.join(rows)}){end}"
    return line if len(line) <= 100 else "(\n" + "".join(f"    {row},\n" for row in rows) + f"){end}"


def argument(row: inspect.Parameter) -> str:
    """Name, type and default. A dataclass as default is shown as a call without arguments."""
    default = row.default
    if default is row.empty:
        return f"{row.name}: {type_name(row.annotation)}"
    shown = f"{type(default).__name__}()" if dataclasses.is_dataclass(default) else repr(default)
    return f"{row.name}: {type_name(row.annotation)} = {shown}"


def type_name(annotation: Any) -> str:
    """A type without its modules."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return re.sub(r"\b(?:\w+\.)+(?=\w)", "", text.replace("'", ""))


def prose(thing: Any) -> str:
    """The docstring; its sections become lists."""
    text = inspect.getdoc(thing) or ""
    lines, section = [], False
    for line in text.splitlines():
        if line.rstrip() in ("Args:", "Returns:", "Raises:"):
            lines += [f"**{line.strip()[:-1]}**", ""]
            section = True
        elif section and line.startswith("    ") and not line.startswith("     "):
            head, colon, rest = line.strip().partition(": ")
            lines.append(f"- `{head}`: {rest}" if colon and " " not in head else f"- {line.strip()}")
        elif section and line.startswith("     "):
            lines.append(f"  {line.strip()}")
        else:
            lines.append(line)
            section = section and not line.strip()
    return "\n".join(lines).strip() + "\n" if text else ""


def field_table(kind: type) -> str:
    """Name, default and meaning of every field of a dataclass, with its unit."""
    texts, rows = field_docs(kind), []
    for field in dataclasses.fields(kind):
        default = "" if field.default is dataclasses.MISSING else f"{field.default!r}"
        rows.append(f"| `{field.name}` | {default} | {texts[field.name]} |")
    return "\n".join(["| field | default | meaning |", "|---|---|---|", *rows, ""])


def field_docs(kind: type) -> dict[str, str]:
    """The string below each field.

    Raises:
        KeyError: a field without one.
    """
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body
    texts = {}
    for field, text in itertools.pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            texts[field.target.id] = " ".join(ast.literal_eval(text.value).split())
    return texts


if __name__ == "__main__":
    write_or_check({PAGE: page()})
