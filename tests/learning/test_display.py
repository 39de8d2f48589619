"""The display of a training: in a terminal and in a pipe."""

import io
import math

import pytest
from rich.console import Console

from arrive.learning.display import TrainingDisplay, level_bars, panel, plain_line
from arrive.learning.report import IterationReport
from reports import make_report


def shown_in_terminal(report: IterationReport, width: int) -> str:
    console = Console(record=True, force_terminal=True, width=width, height=60, file=io.StringIO())
    with TrainingDisplay("anymal_c, stairs, quick", "runs/first", console) as display:
        display.update(report)
    return console.export_text()


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_panel_shows_all_values_at_any_width(width):
    text = shown_in_terminal(make_report(40), width)
    for figure in ("anymal_c, stairs, quick", "runs/first", "40 %", "2:28 elapsed", "3:42 left", "983.04 k samples"):
        assert figure in text
    for figure in (
        "6,512/s",
        "42 %",
        "paid, task reward at 31 % of its maximum",
        "50 %",
        "1.5 of 3",
        "too_far",
        "+0.0712",
    ):
        assert figure in text
    console = Console(record=True, width=width, file=io.StringIO())
    console.print(panel(make_report(40), "anymal_c, stairs, quick", "runs/first"))
    lines = console.export_text().splitlines()
    assert {len(line) for line in lines} == {width}
    assert all(line[0] + line[-1] in ("╭╮", "││", "╰╯") for line in lines)


def test_the_panel_says_that_the_exploration_reward_is_gone():
    assert "removed" in shown_in_terminal(make_report(60), 80)


def test_the_panel_shows_a_run_without_finished_episodes():
    empty = make_report(0, families={}, rewards={}, failures={}, learning={}, time_left_s=math.inf)
    assert "- left" in shown_in_terminal(empty, 80)


def test_level_bars_are_tallest_at_the_most_common_level_and_merge_many_levels():
    assert level_bars((8, 40, 16, 0)).plain == "▃█▄▁"
    assert level_bars((0, 0)).plain == "▁▁"
    assert len(level_bars((1,) * 100).plain) <= 24


def test_a_pipe_gets_lines_at_intervals_and_the_last_one():
    output = io.StringIO()
    with TrainingDisplay("title", "runs/first", Console(file=output, width=80)) as display:
        for iteration in range(1, 6):
            display.update(make_report(iteration))
    lines = output.getvalue().splitlines()
    assert [line.split(" |")[0] for line in lines] == ["title: runs/first", "iteration 1", "iteration 5"]
    assert "stairs 27 % level 1.5" in lines[-1]
    assert plain_line(make_report(5)).isascii()
