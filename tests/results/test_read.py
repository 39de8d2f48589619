"""Result files with every key damaged: each is read correctly, or refused in one line with file and place."""

import json
import math
from typing import Annotated, NotRequired, TypedDict

import pytest

from arrive.errors import ArriveError
from arrive.fields import Range
from arrive.results.check import check_data, check_finite
from arrive.results.read import read_if_there, read_result
from small_results import REMOVED, RESULTS, damaged, damages, refusal

CASES = 300


class Inner(TypedDict):
    share: Annotated[float, Range(0.0, 1.0)]
    pair: NotRequired[tuple[float, float]]


class Outer(TypedDict):
    rows: list[Inner]
    by_name: dict[str, int]
    flag: bool | None


GOOD = {"rows": [{"share": 1, "pair": [0, 1.5]}], "by_name": {"a": 3}, "flag": None, "more": "anything"}


@pytest.mark.parametrize(
    ("place", "wrong", "words"),
    [
        (("rows", 0, "share"), 1.5, r"rows\[0\].share must be a number, 0 to 1, not 1.5"),
        (("rows", 0, "share"), math.nan, r"rows\[0\].share must be a number, 0 to 1, not nan"),
        (("rows", 0, "share"), True, r"rows\[0\].share must be a number, 0 to 1, not True"),
        (("rows", 0, "share"), REMOVED, r"rows\[0\].share is missing"),
        (("rows", 0, "pair"), [1], r"rows\[0\].pair must be a list of 2 values, not a list of 1 value"),
        (("rows", 0), [], r"rows\[0\] must be an object, {...}, not a list of 0 values"),
        (("rows",), [], "rows must be a list of at least one value"),
        (("rows",), {"0": 1}, r"rows must be a list, \[...\], not an object of 1 value"),
        (("by_name", "a"), 3.0, "by_name.a must be an integer below 1e15, not 3.0"),
        (("by_name", "a"), 10**400, "by_name.a must be an integer below 1e15, not a number of more than 60 digits"),
        (("by_name", "a"), "3", "by_name.a must be an integer below 1e15, not '3'"),
        (("flag",), 0, "flag must be true or false, not 0"),
    ],
)
def test_the_message_says_where_and_what_would_be_valid(place, wrong, words):
    check_data(Outer, GOOD)
    with pytest.raises(ArriveError, match=f"^{words}"):
        check_data(Outer, damaged(GOOD, place, wrong))


def test_numbers_that_are_not_finite_are_found_at_any_depth():
    check_finite({"a": [1, "nan", None, True, 10**400]})
    with pytest.raises(ArriveError, match=r"a\[1\].b must be a finite number, not inf"):
        check_finite({"a": [1, {"b": math.inf}]})


@pytest.mark.parametrize("kind", RESULTS)
def test_every_damage_is_refused_in_one_line_that_names_file_and_place(kind, tmp_path):
    content, path = RESULTS[kind](), tmp_path / f"{kind}.json"
    path.write_text(json.dumps(content))
    assert read_result(path, kind) == content
    refused = 0
    for place, _, damage in damages(content, CASES):
        path.write_text(json.dumps(damage))
        message = refusal(lambda: read_result(path, kind))
        refused += message is not None
        if message is not None:
            assert message.startswith((f"cannot read {path}: ", f"{path} holds no result of"))
            keys = [key for key in place if isinstance(key, str)]
            assert any(key in message for key in keys[-2:]), f"{place}: {message}"
            assert "\n" not in message
            assert len(message) < 300 + len(str(path))
    assert refused > CASES / 2


@pytest.mark.parametrize("kind", RESULTS)
def test_no_key_that_a_reader_needs_may_be_missing_or_null_or_a_list_of_lists(kind, tmp_path):
    """But those that the formats name as optional, and those that nobody reads."""
    content, path = RESULTS[kind](), tmp_path / f"{kind}.json"
    accepted = set()
    for place, wrong, damage in damages(content):
        if wrong is REMOVED or wrong == [[1]]:
            path.write_text(json.dumps(damage))
            if refusal(lambda: read_result(path, kind)) is None:
                accepted.add(next(key for key in reversed(place) if isinstance(key, str)))
    optional = {
        "difficulty": {"parameter", "name", "motion", "torque_nm", "gap", "levels", "crash", "fell"},
        "reach": {"gap", "stood_at_m", "direction_deg", "distance_m", "directions", "late", "crash", "distances_m",
                  "directions_deg", "times_s"},
        "energy": {"seed", "finished", "policies", "speeds"},
        "gait": {"seed", "duty", "phase", "gaits", "stands"},
        "stability": {"seed", "runs", "variants", "ours", "short", "long", "seeds"},
        "time_window": {"runs", "energy", "finished"},
    }  # fmt: skip
    assert accepted <= optional[kind]


def test_another_result_and_a_missing_file(tmp_path):
    path = tmp_path / "result.json"
    assert read_if_there(path, "energy") is None
    path.write_text(json.dumps(RESULTS["gait"]()))
    with pytest.raises(ArriveError, match=r"holds no result of 'energy': its protocol\.name is 'gait'"):
        read_result(path, "energy")
    path.write_text('{"protocol": ' + "[" * 100_000)
    with pytest.raises(ArriveError, match="it is not JSON"):
        read_result(path, "energy")
