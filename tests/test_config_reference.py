"""docs/configuration.md is up to date and has every field."""

import pytest

from arrive.commands import known
from arrive.fields import rows
from arrive.presets import PRESETS, get_preset
from arrive.task.registry import TASKS
from arrive.task.rewards import functions
from loading import load


@pytest.fixture(scope="module")
def reference():
    return load("scripts/config_reference.py")


def test_the_page_is_up_to_date(reference):
    assert reference.PAGE.read_text() == reference.page(), "run `python scripts/config_reference.py`"
    assert known.FILE.read_text() == reference.listing(), "run `python scripts/config_reference.py`"


def test_every_field_of_every_task_is_on_the_page_with_a_meaning(reference):
    lines = [line.split(" | ") for line in reference.page().splitlines() if line.startswith("| `")]
    meanings = {cells[0][2:]: cells[-1].removesuffix(" |") for cells in lines}
    tasks = [row for task in TASKS.values() for row in rows(task.Config(), "task.")]
    for row in [*rows(get_preset("paper")), *tasks]:
        assert meanings[f"`{row.path}`"].strip(), row.path


def test_presets_that_differ_have_a_value_each(reference):
    row = next(line for line in reference.page().splitlines() if line.startswith("| `ppo.gamma`"))
    assert ", ".join(f"`{get_preset(name).ppo.gamma}`" for name in PRESETS) in row


def test_every_reward_is_described_once(reference):
    page = reference.page()
    for task in TASKS.values():
        for name, function in functions(task.Config().rewards).items():
            meaning = " ".join((function.__doc__ or "").split("\n\n")[0].split()).replace("|", "\\|")
            (line,) = {line for line in page.splitlines() if line.startswith(f"| `task.rewards.{name}.weight`")}
            assert meaning, name
            assert line.count(meaning) == 1, name


def test_limits_for_the_arithmetic_are_not_shown(reference):
    assert "1e+06" not in reference.page()
    assert str(2**31 - 1) not in reference.page()
    assert "| above 0 and at most 14 |" in reference.page()
