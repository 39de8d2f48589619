"""The report's claims on the paper, its charts, and the files that it reads."""

import json
import re
from pathlib import Path

import pytest

from arrive.errors import ArriveError
from arrive.evaluation.energy import energy_content
from arrive.report import experiments, page
from arrive.report.charts import speed_chart
from arrive.report.experiments import energy_section, gait_section, stability_section, window_section
from arrive.report.markup import chart, command_line, missing
from arrive.report.records import Run
from arrive.report.statements import energy_statements, gait_statements, stability_statements
from arrive.report.training_charts import stability_figure, window_figure
from arrive.report.write import read_results
from small_results import origin, stability, walked, window


def energy(**costs: list[tuple[float, ...]]) -> dict:
    policies = [
        origin(f"walk-{task}", task) | {"speeds": [walked(*row) for row in rows]} for task, rows in costs.items()
    ]
    return energy_content(policies, 50, 100.0, 3)


def verdicts(statements: list[dict]) -> dict[str, str]:
    return {statement["claim"]: statement["verdict"] for statement in statements}


class TestEnergyStatements:
    def test_costs_are_compared_at_equal_speeds(self):
        """V reaches 0.5 to 1.5 m/s, P_f 0.2 to 1.0: at 0.5 m/s P_f costs 60 between its 70 and 50."""
        content = energy(
            velocity=[(0.5, 90.0), (1.5, 60.0)],
            final=[(0.2, 70.0), (0.8, 50.0), (1.0, 50.0)],
            continuous=[(0.3, 60.0), (1.0, 40.0)],
        )
        low, high, alike = energy_statements(content)
        assert low["verdict"] == "holds"
        assert low["why"].startswith("60 against 90 N² m² s/m at 0.50 m/s")
        assert (high["verdict"], high["why"]) == ("holds", "40 against 50 N² m² s/m at 1.00 m/s")
        # V at 1.0 m/s is half way from 90 to 60.
        assert (alike["verdict"], alike["why"]) == ("fails", "40 to 75 N² m² s/m at 1.00 m/s")

    def test_a_claim_is_open_if_intervals_overlap_and_fails_if_costs_are_higher(self):
        near = energy(velocity=[(0.5, 51.0)], final=[(0.5, 50.0)])
        assert verdicts(energy_statements(near))["P_f needs less than V at low speed"] == "open"
        dear = energy(velocity=[(0.5, 51.0)], final=[(0.5, 60.0)])
        assert verdicts(energy_statements(dear))["P_f needs less than V at low speed"] == "fails"

    def test_about_the_same_is_open_if_the_intervals_allow_both_answers(self):
        """Ratios of 50 to 60 and of 50 to 66, where a quarter more is allowed."""
        for dear, half, expected in (
            (60.0, 1.0, "holds"),
            (60.0, 2.0, "open"),
            (66.0, 1.0, "fails"),
            (66.0, 2.0, "open"),
        ):
            content = energy(velocity=[(1.0, dear, half)], final=[(1.0, 50.0, half)], continuous=[(1.0, 55.0, half)])
            assert verdicts(energy_statements(content))["All need about the same at high speed"] == expected

    def test_a_claim_without_a_common_speed_or_a_task_is_open(self):
        for content in (energy(velocity=[(1.0, 50.0)], final=[(0.5, 50.0)]), energy(final=[(0.5, 50.0)])):
            assert set(verdicts(energy_statements(content)).values()) == {"open"}


def gaits(**names: list[str | None]) -> dict:
    return {"policies": [{"name": t, "task": t, "gaits": [{"gait": g} for g in found]} for t, found in names.items()]}


def test_statements_on_gaits():
    content = gaits(velocity=["trot", "trot", "walk"], final=["three-phased", None], continuous=[None])
    assert verdicts(gait_statements(content)) == {
        "V trots": "holds",
        "P_f does not trot": "holds",
        "P_c does not trot": "open",
    }
    assert verdicts(gait_statements(gaits(velocity=["bound"], final=["trot"])))["V trots"] == "fails"


def test_stability_counts_seeds_that_reach_the_goal():
    claim = "flat: better than with half the steps"
    assert verdicts(stability_statements(stability())) == {claim: "open"}, "two seeds decide nothing"
    few = stability()
    few["runs"] = [run | {"success": 1.0 - lost} for run in few["runs"] for lost in (0.0, 0.01) for _ in range(2)]
    for run in few["runs"]:
        run["success"] -= 0.5 * (run["variant"] == "short")
    assert verdicts(stability_statements(few)) == {claim: "holds"}, "4 of 4 seeds against none"
    text = stability_section(stability())
    assert "<td>2 of 2</td><td>90.0 / 92.5 / 95.0</td>" in text
    assert "<td>1 of 2</td><td>89.0 / 94.5 / 100.0</td>" in text


def test_charts_leave_out_missing_trainings():
    figure = window_figure(window())
    assert [len(axes.lines) for axes in figure.axes][1:] == [2, 1, 1]
    assert len(stability_figure(stability(), columns=1).axes) == 2


def test_every_section_without_data_says_which_command_makes_it():
    sections = [energy_section([], None), gait_section([], None), stability_section(None), window_section(None)]
    commands = ["arrive energy", "arrive gait", "python benchmarks/stability.py", "python benchmarks/time_window.py"]
    for section, command in zip(sections, commands, strict=True):
        assert "class=missing" in section
        assert f"<code>{command}" in section
        assert "<img" not in section


def test_every_figure_says_command_seeds_commit_and_budget():
    text = energy_section([], energy(final=[(0.5, 50.0), (1.0, 40.0)]))
    command = "arrive energy walk-final --speeds 0.5 1 --robots 50 --distance 100 --seed 3"
    assert f"<code>{command}</code>" in text
    assert "seed 7, 20.00 M samples, commit abcdef123456" in text
    unknown = "unknown (version 0.1.0, not in a git checkout)"
    copied = energy(final=[(0.5, 50.0)])
    copied["policies"][0]["commit"] = unknown
    assert f"commit {unknown}" in energy_section([], copied)
    for section in (stability_section(stability()), window_section(window())):
        assert "<code>python benchmarks/" in section
        assert re.search(r"seeds 1(, 2)?, commit abc", section)


def test_a_chart_has_one_column_on_a_phone():
    counts = []

    def draw(columns: int):
        counts.append(columns)
        return window_figure(window(), columns)

    text = chart(draw, "a & b", 2)
    assert counts == [2, 1]
    assert 'alt="a &amp; b"' in text
    assert text.count("data:image/svg+xml;base64,") == 2


def test_commands_are_quoted_as_a_shell_needs_it():
    assert command_line("eval", "my run", "--episodes", 5) == "arrive eval 'my run' --episodes 5"
    assert "<code>a &lt; b</code> then <code>c</code>" in missing("Nothing.", "a < b", "c")


class TestResults:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)

    def test_results_are_found_where_their_commands_write_them(self):
        assert read_results({}) == experiments.Results()
        Path("energy.json").write_text(json.dumps(energy(final=[(0.5, 50.0)])))
        Path("runs/stability").mkdir(parents=True)
        Path("runs/stability/stability.json").write_text(json.dumps(stability()))
        results = read_results({"energy": None})
        assert results.energy["protocol"]["name"] == "energy"
        assert results.stability == stability()
        assert results.gait is None

    def test_another_file_is_refused(self):
        Path("other.json").write_text(json.dumps(stability()))
        with pytest.raises(ArriveError, match=r"other.json holds no result of 'gait'"):
            read_results({"gait": Path("other.json")})
        with pytest.raises(ArriveError, match=r"cannot read nowhere.json"):
            read_results({"gait": Path("nowhere.json")})


def test_the_section_on_time_names_the_duration_of_the_trial():
    profile = {"time_s": [0.1, 0.2], "mean_m_s": [0.5, 0.6]}
    quartiles = {"arrival_time_s": [3.0, 4.0, 5.0], "path_length_m": [5.0, 5.5, 6.0]}
    usage = {"gap": [quartiles | {"value": 0.1, "episodes": 9, "speed_profile": profile}]}
    level = {"value": 0.1, "episodes": 10, "success": 0.9, "interval": [0.6, 0.98], "failures": {"late": 1}}
    family = {"levels": [level], "parameter": "width", "unit": "m"}
    trial = {"duration_s": 12.0, "walk": 6.0, "target": [7.0, 0.0]}
    difficulty = {"families": {"gap": family}, "policy": {"usage": usage}, "protocol": {"trial": trial}}
    run = Run("twelve", {"config": {"task": {"name": "final"}}}, {}, difficulty, {})
    text = page._usage([run])
    assert "12 s were given" in text
    assert "6 m walked" in text
    axes, *_ = speed_chart([run]).axes
    assert axes.get_xlim() == (0.0, 12.0)
