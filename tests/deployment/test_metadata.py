"""Every field of an exported file's metadata, damaged: each reader takes the file, or says why in one line."""

import copy
import json
import os
from collections import Counter

import numpy as np
import onnx
import pytest

import small_results
from arrive import cli
from arrive.deployment import Controller
from arrive.deployment.onnx_file import PREFIX, SEAL, append_checksum
from arrive.deployment.policy_file import SECTIONS, read_policy_file
from arrive.deployment.reading import load_exported
from arrive.deployment.verify import file_summary, verify
from arrive.errors import ArriveError, shown
from arrive.play.skills import open_skill
from arrive.report.records import read_run

ODD_TEXTS = (
    "",
    " ",
    "LF_HÄÄ",
    "关节",
    "\u202egnirts",
    "e\u0301",
    "a\0b",
    "\x1b[2J",
    "a\nb",
    "\ud800",
    "\U0001f916" * 3,
    "x" * 10_000,
)
NUMBERS = (0, -1, 2, 1e-320, 1e30, -1e30, 10**400, 2**63)
OTHERS = (*NUMBERS, None, True, False, "1", "rad", "mm", [], [[]], [1.0], {}, {"a": 1})
EXTREMES = ("NaN", "Infinity", "-Infinity", "1e999")
"""JSON that Python reads although it is none, or reads as infinity."""
NO_JSON = (
    "",
    "{",
    "nul",
    '{"a": 1',
    "[1,]",
    "'a'",
    "\ufeff{}",
    "[" * 50_000,
    '{"a":' * 50_000,
    "{}{}",
    "\0",
    "9" * 5000,
)
CASES = int(os.environ.get("ARRIVE_METADATA_CASES", "50"))
"""Damages of each section that are tried, of up to some hundreds."""
FEW = 1
"""So many entries of a list are damaged, and the last one."""


def places(value, path=()):
    """The place of every value, but only of some in a list."""
    yield path
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        for i in sorted({*range(min(FEW, len(value))), len(value) - 1} - {-1}):
            yield from places(value[i], (*path, i))


def at(content, path):
    for key in path:
        content = content[key]
    return content


def with_value(content, path, value):
    """A copy with another value at a place."""
    if not path:
        return value
    content = copy.copy(content)
    content[path[0]] = with_value(content[path[0]], path[1:], value)
    return content


def damages(content, path, rng):
    """Name and text of one section's JSON for every damage at one place. Of those by type, a few at random."""
    value = at(content, path)
    for other in [OTHERS[i] for i in rng.choice(len(OTHERS), 3, replace=False)]:
        yield f"{other!r:.20}", json.dumps(with_value(content, path, other))
    if isinstance(value, str):
        for text in (*ODD_TEXTS, value.upper(), value + " "):
            yield f"{text!r:.20}", json.dumps(with_value(content, path, text), ensure_ascii=bool(rng.integers(2)))
    if isinstance(value, float | int) and not isinstance(value, bool):
        for other in (-value, value * 1000.0, value * 180.0 / np.pi, value / 1000.0, str(value)):
            yield f"{other!r:.20}", json.dumps(with_value(content, path, other))
        for text in EXTREMES:
            yield text, json.dumps(with_value(content, path, "HERE")).replace('"HERE"', text)
    if isinstance(value, list):
        for name, other in (("longer", [*value, *value[-1:]]), ("shorter", value[:-1]), ("reversed", value[::-1]),
                            ("nested", [value]), ("flat", str(value))):  # fmt: skip
            yield name, json.dumps(with_value(content, path, other))
    if isinstance(value, dict):
        for key in value:
            yield f"without {key}", json.dumps(with_value(content, path, {k: v for k, v in value.items() if k != key}))
            twice = json.dumps(with_value(content, path, {"HERE": 0} | value))
            yield f"{key} twice", twice.replace('"HERE": 0', f"{json.dumps(key)}: 1")
        for key in ("", "añadido", "\ud800", "__class__", "name\0"):
            yield f"with {key!r}", json.dumps(with_value(content, path, value | {key: 1}))


class Workshop:
    """Copies of an exported file with other metadata and a checksum that agrees."""

    def __init__(self, exported, folder):
        self.model = onnx.load_from_string(exported.read_bytes())
        self.texts = {x.key.removeprefix(PREFIX): x.value for x in self.model.metadata_props}
        del self.texts[SEAL]
        measured = small_results.difficulty()
        del measured["policy"]
        self.texts["evaluation"] = json.dumps(measured)
        del self.model.metadata_props[:]
        self.path = folder / "changed.onnx"

    def made(self, texts: list[tuple[str, str]]):
        body = self.model.SerializeToString()
        for key, text in texts:
            # As bytes, because protobuf writes no lone surrogates.
            key, value = (PREFIX + key).encode(), text.encode("utf-8", "surrogatepass")
            entry = b"\x0a" + varint(len(key)) + key + b"\x12" + varint(len(value)) + value
            body += b"\x72" + varint(len(entry)) + entry
        self.path.write_bytes(append_checksum(body))
        return self.path

    def with_section(self, section: str, text: str):
        return self.made([*(self.texts | {section: text}).items()])


def varint(value: int) -> bytes:
    out = b""
    while value >= 128:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


@pytest.fixture(scope="module")
def workshop(exported, tmp_path_factory):
    return Workshop(exported, tmp_path_factory.mktemp("metadata"))


def uses(path) -> str:
    """What each reader does with a file: "" if all take it, otherwise the first error. Any other error is a failure."""
    try:
        file = read_policy_file(path)
        Controller(file)
        file_summary(file)
        skill = open_skill(str(path))
        assert skill.config
        assert skill.samples >= 0
        assert skill.ground("training")
        load_exported(path)
        read_run(path)
        verify(path)
    except ArriveError as error:
        return str(error)
    return ""


def test_an_unchanged_file_is_taken_by_all(workshop):
    assert uses(workshop.made([*workshop.texts.items()])) == ""


@pytest.mark.parametrize("section", SECTIONS)
def test_every_damage_is_one_line_or_harmless(workshop, section):
    rng, content = np.random.default_rng(11), json.loads(workshop.texts[section])
    cases = [(path, *damage) for path in places(content) for damage in damages(content, path, rng)]
    order = rng.permutation(len(cases))[:CASES]
    outcomes = Counter()
    for path, name, text in (cases[i] for i in order):
        case = f"{section}{list(path)}: {name}"
        try:
            message = uses(workshop.with_section(section, text))
        except Exception as error:
            raise AssertionError(f"{case}: {error!r}") from error
        outcomes["refused" if message else "taken"] += 1
        assert len(shown(message)) < 1500, (case, message)
        assert not message or "changed.onnx" in message or "Valid: " in message, (case, message)
    print(section, dict(outcomes))
    assert outcomes["refused"] > outcomes["taken"], outcomes
    for text in NO_JSON:
        assert "changed.onnx" in uses(workshop.with_section(section, text)), text[:20]


def test_sections_that_are_missing_doubled_or_of_no_text(workshop):
    sections = [*workshop.texts.items()]
    for i, (name, text) in enumerate(sections):
        assert "changed.onnx" in uses(workshop.made(sections[:i] + sections[i + 1 :])), name
        assert "twice" in uses(workshop.made([*sections, (name, text)])), name
        assert "changed.onnx" in uses(workshop.with_section(name, "\udcff" + text)), name
    assert uses(workshop.made([*sections, ("ñ", '"\u202e"')])) == ""


@pytest.mark.parametrize("command", [("verify",), ("eval",), ("play", "--seconds", "1"), ("drive", "--seconds", "1")])
def test_commands_say_one_line(workshop, capsys, command):
    robot = json.loads(workshop.texts["robot"])
    for name in ("\x1b[2J\nname", "\ud800", "\u202e", "x" * 10_000):
        path = workshop.with_section("robot", json.dumps(robot | {"name": name, "stiffness": name}))
        with pytest.raises(SystemExit) as stop:
            cli.main([command[0], str(path), *command[1:]])
        said = capsys.readouterr()
        assert stop.value.code == 1
        assert said.out.count("\n") == (command[0] == "eval"), "the device"
        assert said.err.startswith("arrive: ")
        assert said.err.count("\n") == 1
        assert said.err[:-1].isprintable()
        assert len(said.err) < 2000
