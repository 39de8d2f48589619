"""Options of a training: watch it, film it, send its metrics to wandb, start from another run's configuration."""

import shutil
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rsl_rl.utils.wandb_log_writer as wandb_log_writer

from arrive import __version__, cli, plugins
from arrive.commands import films
from arrive.commands.films import Films
from arrive.config import Config
from arrive.evaluation.arrival import choose_cells
from arrive.learning import logs
from arrive.learning.logs import RunLog, read_log
from arrive.learning.report import FamilyReport
from arrive.learning.rundir import read_config
from arrive.play.follow import Follower
from arrive.play.playground import Playground
from arrive.play.skills import open_skill
from arrive.policies import SHIPPED
from arrive.terrain import FAMILIES
from arrive.terrain.ground import ground_of
from reports import make_report
from settings import SMALL

TINY = ["--iterations", "1", "--num-envs", "16", "--threads", "1"]


def train(capsys, *arguments: str) -> str:
    cli.main(["train", "flat", *TINY, *arguments])
    return capsys.readouterr().out


def refused(capsys, *arguments: str) -> str:
    with pytest.raises(SystemExit):
        cli.main(["train", "flat", *TINY, *arguments])
    return capsys.readouterr().err


def config_of(run: Path) -> Config:
    return read_config(run)[0]


def test_a_run_begins_from_the_settings_of_another(tmp_path, capsys):
    first, second = tmp_path / "first", tmp_path / "second"
    train(capsys, "--out", str(first), "--set", *SMALL, "ppo.gamma=0.9", "task.rewards.stall_cost=-3")
    settings = tmp_path / "settings.json"
    shutil.copy(first / "config.json", settings)
    train(capsys, "--out", str(second), "--config", str(settings), "--seed", "7", "--set", "ppo.gamma=0.8")
    one, other = asdict(config_of(first)), asdict(config_of(second))
    assert (one.pop("seed"), other.pop("seed")) == (1, 7)
    assert (one["ppo"].pop("gamma"), other["ppo"].pop("gamma")) == (0.9, 0.8)
    assert one == other
    assert "its own preset" in refused(capsys, "--config", str(settings), "--preset", "paper")
    assert "cannot read" in refused(capsys, "--config", str(first / "log.csv"))


# Weights & Biases.


class FakeWandb:
    """Takes down what it is told, in the place of the package."""

    def __init__(self):
        self.started, self.told, self.scalars = {}, {}, []
        self.config = SimpleNamespace(update=self.told.update)

    def init(self, **options):
        self.started = options

    def log(self, scalars, step):
        self.scalars.append((step, scalars))


def test_wandb_gets_the_metrics_of_the_log_and_the_configuration(tmp_path, capsys, monkeypatch):
    fake = FakeWandb()
    monkeypatch.setattr(wandb_log_writer, "wandb", fake)
    monkeypatch.setattr(logs, "has_wandb", lambda: True)
    run = tmp_path / "mine"
    train(capsys, "--out", str(run), "--logger", "wandb", "--set", *SMALL)
    assert fake.started["name"] == "mine"
    assert fake.told["env_cfg"] == asdict(config_of(run))
    told = {name: value for step, scalars in fake.scalars for name, value in scalars.items() if step == 1}
    logged = {name: column[0] for name, column in read_log(run).items() if np.isfinite(column[0])}
    del logged["iteration"]
    assert told == pytest.approx(logged)
    assert list((run / "tensorboard").rglob("events*")), "TensorBoard has them too"


def test_without_wandb_the_message_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setattr(logs, "has_wandb", lambda: False)
    with pytest.raises(Exception, match="pip install wandb"):
        RunLog(tmp_path, "wandb")


# Films.


def test_films_are_made_every_few_minutes_and_never_two_at_once(tmp_path, monkeypatch):
    clock, started, busy = [0.0], [], [None]
    monkeypatch.setattr(films.time, "monotonic", lambda: clock[0])
    process = SimpleNamespace(poll=lambda: busy[0], wait=lambda: None, returncode=0)
    monkeypatch.setattr(films.subprocess, "Popen", lambda words, **_: started.append(words) or process)
    monkeypatch.setattr(plugins, "_imported", {"mine": "/my/mine.py", "a.b": "a.b", "theirs": "package theirs"})
    (tmp_path / "policy.pt").touch()
    told = []
    made = Films(tmp_path, 2.0, told.append)
    report = make_report(1, samples=1_500_000)
    for clock[0], count in ((119.0, 0), (121.0, 1), (242.0, 1)):
        made.tick(report)
        assert len(started) == count
    busy[0] = 0
    made.tick(replace(report, samples=2_500_000))
    assert [words[words.index("--pictures") + 1] for words in started] == [
        str(tmp_path / "films" / name) for name in ("0001.50M", "0002.50M")
    ]
    imports = ["--import", "/my/mine.py", "--import", "a.b"]
    assert started[0][:8] == [sys.executable, "-m", "arrive", *imports, "eval"]
    assert told == ["no film: exit status 0"], "the first process made none"
    Films(tmp_path, None, told.append).tick(report)
    assert len(started) == 2


def test_a_film_shows_every_terrain_at_the_level_that_its_robots_have_reached():
    families = {"flat": FamilyReport(1.0, 0.0, (8,)), "pit": FamilyReport(0.5, 1.6, (1, 2, 3, 0))}
    terrain = ",".join(films._at_level(*item) for item in families.items())
    chosen = choose_cells(config_of(SHIPPED / "pit"), terrain)
    assert [(family.name, cell and cell.value) for family, cell in chosen] == [
        ("flat", None),
        ("pit", FAMILIES["pit"].value(2, 4)),
    ]


def test_a_film_that_fails_says_why(tmp_path):
    (tmp_path / "policy.pt").write_bytes(b"half a file")
    told = []
    made = Films(tmp_path, 0.0, told.append)
    made.tick(make_report(1))
    made.close()
    (line,) = told
    assert line.startswith(f"no film: cannot read {tmp_path / 'policy.pt'}")


@pytest.mark.parametrize("minutes", ["0", "-1", "nan"])
def test_a_wrong_time_between_films_is_refused(tmp_path, capsys, minutes):
    said = refused(capsys, "--out", str(tmp_path / "run"), "--film-minutes", minutes, "--set", *SMALL)
    assert "--film-minutes must be above 0" in said


# Following a run.


def test_the_newest_network_takes_over_where_the_robot_is(tmp_path):
    for name in ("policy.pt", "config.json"):
        shutil.copy(SHIPPED / "walk" / name, tmp_path)
    playground = Playground(open_skill(str(tmp_path)), ground_of("flat"))
    playground.go()
    for _ in range(40):
        playground.step()
    follower = Follower(str(tmp_path), lambda request: request(playground))
    first, place, clock = playground.skill, playground.robot.base_pos_w, playground.time_s
    follower.look()
    assert playground.skill is first, "the file is still the same"
    shutil.copy(SHIPPED / "gap" / "policy.pt", tmp_path)
    follower.look()
    assert playground.skill.policy.meta["golden"] == open_skill("gap").policy.meta["golden"]
    np.testing.assert_array_equal(playground.robot.base_pos_w, place)
    playground.step()
    assert playground.time_s > clock
    assert playground.target is not None, "it is still on its way"
    (tmp_path / "policy.pt").write_bytes(b"half a file")
    follower.look()
    assert "cannot read" in playground.messages[-1]
    assert playground.skill.policy.meta["golden"] == open_skill("gap").policy.meta["golden"]


def test_the_version_is_printed(capsys):
    cli.main(["--version"])
    assert capsys.readouterr().out == f"arrive {__version__}\n"
