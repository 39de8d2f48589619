"""docs/metrics.md explains every metric that training logs, and no other."""

import re

import pytest

from arrive import cli
from arrive.learning.logs import read_log
from arrive.learning.metrics import METRICS, Metric
from loading import load


def find_metric(column: str) -> Metric | None:
    """The metric of a column of the log, or None if there is none."""
    return next((metric for metric in METRICS if metric.describes(column)), None)


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    """Columns of a run whose episodes end, on two terrain families, with the schedule."""
    folder = tmp_path_factory.mktemp("metrics") / "run"
    small = ["ppo.hidden=[16]", "terrain.levels=2", "terrain.variants=1", "schedule.enabled=true"]
    short = ["task.episode_s=0.4", "task.episode_min_s=0.4", "task.reward_window_s=0.2"]
    options = ["--preset", "paper", "--threads", "1", "--num-envs", "16", "--iterations", "1"]
    cli.main(["train", "flat,gap", *options, "--out", str(folder), "--set", *small, *short])
    return set(read_log(folder))


def test_the_page_is_up_to_date():
    reference = load("scripts/metrics_reference.py")
    assert reference.PAGE.read_text() == reference.page(), "run `python scripts/metrics_reference.py`"


def test_every_logged_column_is_explained(columns):
    assert sorted(column for column in columns if find_metric(column) is None) == []


def test_every_explained_metric_is_logged(columns):
    logged = {find_metric(column) for column in columns}
    assert [metric.name for metric in METRICS if metric not in logged] == ["warnings/NAME"]  # a sound run has none


def test_a_name_for_many_matches_its_group_alone():
    assert find_metric("arrival/all").name == "arrival/all"
    assert find_metric("arrival/pit").name == "arrival/FAMILY"
    assert find_metric("learning/new_loss") is None
    assert find_metric("somewhere/else") is None


def test_names_are_unique_and_every_metric_has_a_unit():
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    assert all(metric.unit and metric.meaning for metric in METRICS)
    assert not any(re.search(r"\|", metric.meaning) for metric in METRICS)
