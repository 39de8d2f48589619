"""The reference of the configuration says what the code says, of every field."""

import pytest

from arrive.fields import rows
from arrive.presets import PRESETS, get_preset
from arrive.task.registry import TASKS
from loading import load


@pytest.fixture(scope="module")
def reference():
    return load("scripts/config_reference.py")


def test_the_page_is_up_to_date(reference):
    assert reference.PAGE.read_text() == reference.page(), "run `python scripts/config_reference.py`"


def test_every_field_of_every_task_is_on_the_page_with_a_meaning(reference):
    lines = [line.split(" | ") for line in reference.page().splitlines() if line.startswith("| `")]
    meanings = {cells[0][2:]: cells[-1].removesuffix(" |") for cells in lines}
    tasks = [row for task in TASKS.values() for row in rows(task.Config(), "task.")]
    for row in [*rows(get_preset("paper")), *tasks]:
        assert meanings[f"`{row.path}`"].strip(), row.path


def test_presets_that_differ_have_a_value_each(reference):
    row = next(line for line in reference.page().splitlines() if line.startswith("| `ppo.gamma`"))
    assert ", ".join(f"`{get_preset(name).ppo.gamma}`" for name in PRESETS) in row


def test_every_reward_says_what_it_pays_for(reference):
    for task in TASKS.values():
        assert all(reference.meanings_of_rewards(task.Config()).values()), task
