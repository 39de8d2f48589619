"""Training that learns nothing gives warnings, and normal training gives none."""

import io
import re

import pytest
from rich.console import Console

from arrive.learning.display import TrainingDisplay
from arrive.learning.logs import RunLog, read_log
from arrive.learning.report import FamilyReport, IterationReport
from arrive.learning.watch import find_warnings


def report(**changes) -> IterationReport:
    """A healthy run after 5 million samples."""
    figures = {
        "iteration": 400,
        "samples": 5_000_000,
        "elapsed_s": 600.0,
        "budget": 0.5,
        "time_left_s": 600.0,
        "samples_per_s": 8000.0,
        "arrival": 0.6,
        "diverged_share": 0.0,
        "exploration_paid": 1.0,
        "task_fraction": 0.3,
        "families": {"flat": FamilyReport(0.9, 0.0, (64,)), "gap": FamilyReport(0.4, 1.5, (8, 40, 16))},
        "failures": {"crash": 0.3, "fell": 0.05},
    }
    return IterationReport(**figures | changes)


STUCK = {"gap": FamilyReport(0.1, 0.02, (63, 1, 0))}
SYMPTOMS = {
    "diverging": ({"diverged_share": 0.9, "iteration": 1, "samples": 100}, "simulation diverges.*timestep_s"),
    "crashing": ({"failures": {"crash": 0.6, "fell": 0.38}, "arrival": 0.0}, "98% .* in a crash.*randomisation"),
    "arriving": ({"arrival": 0.01}, "1% of the episodes arrive after 5.0 M samples.*gamma"),
    "levels": ({"families": STUCK}, "on gap are still on the first level.*terrain.demotion_share"),
}


@pytest.mark.parametrize("name", SYMPTOMS)
def test_each_symptom_has_its_warning_with_likely_causes(name):
    changes, words = SYMPTOMS[name]
    warnings = find_warnings(report(**changes)).warnings
    assert list(warnings) == [name]
    assert "Likely causes: " in warnings[name]
    assert re.search(words, warnings[name])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"diverged_share": 0.3},
        {"arrival": 0.0, "failures": {"crash": 1.0}, "samples": 500_000, "iteration": 40},  # fresh networks
        {"arrival": 0.0, "failures": {"crash": 1.0}, "iteration": 20},  # thousands of robots, few updates
        {"arrival": 0.0, "samples": 2_000_000, "iteration": 160},
        {"arrival": float("nan"), "failures": {}},  # no episode has ended
        {"families": STUCK, "samples": 1_000_000},
        {"families": {"flat": FamilyReport(0.9, 0.0, (960,)), **STUCK}},  # few robots, few samples there
    ],
    ids=str,
)
def test_normal_trainings_have_no_warning(changes):
    assert find_warnings(report(**changes)).warnings == {}


def test_a_warning_reaches_display_and_log_once(tmp_path):
    output, log = io.StringIO(), RunLog(tmp_path)
    with TrainingDisplay("title", "folder", Console(file=output, width=500)) as display:
        for iteration, arrival in ((399, 0.6), (400, 0.0), (401, 0.0), (402, 0.6)):
            result = find_warnings(report(iteration=iteration, arrival=arrival))
            log.write(result)
            display.update(result)
    log.close()
    assert output.getvalue().count("warning: 0% of the episodes arrive") == 1
    assert [value == 1.0 for value in read_log(tmp_path)["warnings/arriving"]] == [False, True, True, False]
    assert texts(tmp_path) == ["warnings/arriving/text_summary"]
    terminal = Console(record=True, force_terminal=True, width=100, height=60, file=io.StringIO())
    with TrainingDisplay("title", "folder", terminal) as display:
        display.update(find_warnings(report(arrival=0.0)))
    assert "warning: 0% of the episodes arrive" in terminal.export_text()


def texts(folder) -> list[str]:
    """Names of the texts in the TensorBoard files."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    return EventAccumulator(str(folder / "tensorboard")).Reload().Tags()["tensors"]
