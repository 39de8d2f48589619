"""The benchmarks `stability` and `time_window`: their variants, what they reuse, and their reports."""

import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest
import torch

from arrive.config import override
from arrive.learning.run_files import RunProgress
from arrive.learning.trainer import explained_variance
from arrive.presets import PRESETS, get_preset
from arrive.report.experiments import stability_section, window_section
from arrive.task.final import FinalPositionTask

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
with pytest.MonkeyPatch.context() as patch:
    patch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    import stability
    import time_window
    import trainings


def test_explained_variance_by_hand():
    """Returns 0, 2, 4, 6 have the sum of squares 20; errors -1, 1, -1, 1 have 4."""
    returns = torch.tensor([0.0, 2.0, 4.0, 6.0])
    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(torch.full((4,), 9.0), returns) == pytest.approx(0.0)
    assert explained_variance(torch.tensor([1.0, 1.0, 5.0, 5.0]), returns) == pytest.approx(1.0 - 4.0 / 20.0)
    assert explained_variance(torch.zeros(4), torch.ones(4)) == 0.0


@pytest.mark.parametrize("preset", list(PRESETS))
def test_each_variant_undoes_one_change_and_the_last_undoes_all(preset):
    config = get_preset(preset)
    variants = stability.variants(config).values()
    ours, half, long, bootstrapped, everything = (override(config, variant.settings) for variant in variants)
    assert ours == config
    assert half.ppo.num_steps == everything.ppo.num_steps == config.ppo.num_steps // 2
    assert long.task.episode_s == long.task.episode_min_s == everything.task.episode_s == 20.0
    assert half.task == config.task
    assert long.ppo == config.ppo
    assert bootstrapped == config
    assert [variant.module is not None for variant in variants] == [False, False, False, True, True]


def test_variants_say_the_numbers_that_are_compared():
    """Also those that --set has changed."""
    words = [variant.words for variant in stability.variants(get_preset("robust")).values()]
    assert words == [
        "12 steps per iteration, episodes of 5 to 8 s, time-outs not bootstrapped",
        "6 instead of 12 steps per iteration",
        "episodes of 20 s instead of 5 to 8 s",
        "bootstrapped time-outs",
        "6 steps, episodes of 20 s and bootstrapped time-outs",
    ]
    changed = stability.variants(override(get_preset("paper"), ("ppo.num_steps=24",)))
    assert changed["half steps"].words == "12 instead of 24 steps per iteration"
    assert changed["half steps"].settings == ("ppo.num_steps=12",)


def test_the_module_bootstraps(monkeypatch):
    monkeypatch.setattr(FinalPositionTask, "bootstraps", False)
    runpy.run_path(str(stability.BOOTSTRAPPING))
    assert FinalPositionTask.bootstraps


class TestTraining:
    @pytest.fixture
    def training(self, tmp_path, monkeypatch):
        self.calls = []
        monkeypatch.setattr(trainings, "arrive", lambda *words: self.calls.append(words))
        monkeypatch.setattr(trainings, "load_policy", lambda folder: folder)
        return trainings.Training(tmp_path / "run", "gap=0.2", 3, 5e6, "robust", ("ppo.gamma=0.9",), 1)

    def test_a_new_training_starts_with_its_settings(self, training):
        training.finish()
        (words,) = self.calls
        assert words[:4] == ("train", "gap", "--samples", "5000000")
        assert words[-2:] == ("--set", "ppo.gamma=0.9")
        assert {"--seed", "3", "--preset", "robust", "--out"} <= set(words)

    @pytest.mark.parametrize(("samples", "goes_on"), [(1_000_000, True), (5_010_000, False)])
    def test_an_interrupted_training_is_continued_and_a_finished_one_is_not(
        self, training, monkeypatch, samples, goes_on
    ):
        training.folder.mkdir()
        (training.folder / "checkpoint.pt").touch()
        monkeypatch.setattr(trainings, "read_progress", lambda folder: RunProgress(1, samples, 1.0))
        training.finish()
        assert len(self.calls) == goes_on
        if goes_on:
            assert self.calls[0][-2:] == ("--resume", str(training.folder))
            assert "--set" not in self.calls[0]

    def test_figures_of_the_critic_are_means_over_the_last_tenth(self, training):
        training.folder.mkdir()
        rows = [f"{i},{i * 100},{i},{0.1 * i},{i}" for i in range(1, 21)]
        head = "iteration,progress/samples,progress/elapsed_s,learning/explained_variance,learning/value"
        (training.folder / "log.csv").write_text("\n".join([head, *rows]) + "\n")
        critic = training.critic()
        assert critic["explained_variance"] == pytest.approx(1.95)
        assert critic["value_loss"] == pytest.approx(19.5)
        assert critic["curve"]["samples"][-1] == 2000


class Made:
    """A training that took no time."""

    made: ClassVar[list] = []

    def __init__(self, folder, ground, seed, samples, preset, settings, threads, module=None):
        self.settings = settings
        Made.made.append((str(folder.name), settings))

    def finish(self):
        return SimpleNamespace(samples=1000, commit="0123abcd")

    def measure(self, policy, episodes):
        usage = {"arrival_time_s": [1.0, 2.0, 3.0], "path_length_m": [4.0, 5.0, 6.0]}
        profile = {"speed_profile": {"time_s": [0.1], "mean_m_s": [0.5]}}
        return {"success": 0.95, "interval": [0.9, 0.97], "usage": usage | profile}

    def critic(self):
        curve = {"samples": [1.0], "explained_variance": [0.5]}
        return {"explained_variance": 0.5, "value_loss": 0.1, "curve": curve}


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(Made, "made", [])
    monkeypatch.setattr(stability, "Training", Made)
    monkeypatch.setattr(time_window, "Training", Made)
    return Made.made


def test_stability_trains_every_variant_of_every_seed_and_the_report_shows_it(made, tmp_path, capsys):
    stability.main(stability.Arguments(seeds=(1, 2), grounds=("flat", "gap=0.2"), out=tmp_path))
    assert len(made) == len({name for name, _ in made}) == 2 * 2 * 5
    content = json.loads((tmp_path / "stability.json").read_text())
    assert len(content["runs"]) == 20
    assert "| flat | 6 instead of 12 steps per iteration | 2 of 2 |" in capsys.readouterr().out
    assert "2 of 2" in stability_section(content)


def test_stability_continues_from_its_result_alone(made, tmp_path):
    """On another machine too, where the runs' folders are not; what was there before stays."""
    stability.main(stability.Arguments(seeds=(1,), grounds=("flat",), out=tmp_path))
    stability.main(stability.Arguments(seeds=(2, 1), grounds=("flat",), out=tmp_path))
    assert len(made) == 2 * 5
    stability.main(stability.Arguments(seeds=(3,), grounds=("flat",), out=tmp_path))
    content = json.loads((tmp_path / "stability.json").read_text())
    assert content["protocol"]["seeds"] == [1, 2, 3]
    assert len(content["runs"]) == 3 * 5


def test_results_of_another_benchmark_are_not_mixed_in(made, tmp_path):
    arguments = stability.Arguments(seeds=(1,), grounds=("flat",), out=tmp_path)
    stability.main(arguments)
    with pytest.raises(SystemExit, match=r"runs with samples 5000000.0 instead of 1000000.0; choose"):
        stability.main(replace(arguments, samples=1e6))
    assert len(made) == 5


def test_the_window_goes_from_half_a_second_to_the_whole_episode(made, tmp_path, monkeypatch, capsys):
    costs = {"speeds": [{"torque_sq": None, "speed": None}]}
    monkeypatch.setattr(time_window, "measure_energy", lambda *args: costs)
    time_window.main(time_window.Arguments("gap=0.2", windows=(4.0,), out=tmp_path))
    time_window.main(time_window.Arguments("gap=0.2", out=tmp_path))
    windows = [override(get_preset("robust"), settings).task.reward_window_s for _, settings in made]
    assert windows == [4.0, 0.5, 1.0, 2.0, 8.0], "4 s was there already"
    content = json.loads((tmp_path / "time_window.json").read_text())
    assert [run["window_s"] for run in content["runs"]] == [0.5, 1.0, 2.0, 4.0, 8.0]
    assert content["protocol"]["episode_s"] == 8.0
    assert "no robot walked" in capsys.readouterr().out
    assert "<img" in window_section(content)
    with pytest.raises(SystemExit, match="at most the episode of 8 s"):
        time_window.main(time_window.Arguments("gap=0.2", windows=(9.0,), out=tmp_path))
