"""docs/deployment-reference.md is up to date, with all arguments and units."""

import dataclasses
import inspect
from pathlib import Path

import pytest

import arrive.deployment
from loading import load

PUBLIC = {name: getattr(arrive.deployment, name) for name in arrive.deployment.__all__}
RECORDS = [thing for thing in PUBLIC.values() if dataclasses.is_dataclass(thing)]


@pytest.fixture(scope="module")
def reference():
    return load("scripts/deployment_reference.py")


def test_the_page_is_up_to_date(reference):
    assert reference.PAGE.read_text() == reference.page(), "run `python scripts/deployment_reference.py`"


def test_everything_public_has_its_arguments_on_the_page(reference):
    for name, thing in PUBLIC.items():
        section = reference.page().split(f"## `{name}`\n", 1)[1].split("\n## ", 1)[0]
        calls = [thing] if inspect.isclass(thing) or inspect.isfunction(thing) else []
        if inspect.isclass(thing):
            calls += [member for key, member in vars(thing).items() if key[0] != "_" and inspect.isfunction(member)]
        for call in calls:
            for argument in inspect.signature(call).parameters:
                assert argument == "self" or f"{argument}: " in section, (name, argument)


@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_a_unit_in_a_name_is_also_in_its_documentation(reference, kind):
    texts = reference.field_docs(kind)
    assert set(texts) == {field.name for field in dataclasses.fields(kind)}
    for name, text in texts.items():
        for ending, unit in (("_rad_s", "[rad/s]"), ("_m_s", "[m/s]"), ("_s", "[s]"), ("_m", "[m]"), ("_rad", "[rad]")):
            if name.endswith(ending):
                assert unit in text, f"{kind.__name__}.{name}: {text}"
                break


def test_docstrings_become_markdown(reference):
    def example(self, size: int, name: "str" = "x") -> "Path":
        """Do it.

        Args:
            size: of the thing,
                in two lines [m].

        Returns:
            (n,) numbers.

        Raises:
            ValueError: it cannot be done.
        """

    assert reference.signature(example) == "(size: int, name: str = 'x') -> Path"
    text = "Do it.\n\n**Args**\n\n- `size`: of the thing,\n  in two lines [m].\n\n**Returns**\n\n- (n,) numbers.\n"
    assert reference.prose(example) == text + "\n**Raises**\n\n- `ValueError`: it cannot be done.\n"


def test_every_limit_of_the_watchdog_is_in_the_guide(reference):
    guide = (reference.PAGE.parent / "deployment.md").read_text()
    for field in dataclasses.fields(arrive.deployment.Safety):
        assert f"`{field.name}`" in guide, field.name
