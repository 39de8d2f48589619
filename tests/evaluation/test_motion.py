"""Measurements of motion with scripted robots, and their place in the card."""

import json
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.cli import main
from arrive.commands import evaluation
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig
from arrive.env import ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.legs import LegCrossing
from arrive.evaluation.motion import UNITS, MotionMeter, summary
from arrive.evaluation.playing import play
from arrive.presets import PAPER_REWARDS
from arrive.report.card import write_card
from arrive.report.records import read_run
from arrive.task.final import FinalConfig

CALM = RandomisationConfig(
    friction=(1.0, 1.0), payload_kg=(0.0, 0.0), push_speed=0.0, start_offset=0.0, start_speed=0.0, start_joint_scale=0.0
)


def an_env(num_envs: int = 2) -> ArriveEnv:
    config = Config(
        num_envs=num_envs,
        terrain=TerrainConfig(families=("flat",), levels=1, variants=1),
        observation=ObservationConfig(noise=False),
        randomisation=CALM,
        task=FinalConfig(rewards=PAPER_REWARDS),
    )
    nowhere = torch.zeros(num_envs, dtype=torch.long)
    return build_env(config, Placement(assignment=(nowhere, nowhere)), threads=1)


class Scripted:
    """Repeats a list of actions, the same for every joint."""

    def __init__(self, *actions: float):
        self._actions, self._step = actions, 0

    def act(self, observation: Tensor) -> Tensor:
        self._step += 1
        return torch.full((len(observation), 12), self._actions[(self._step - 1) % len(self._actions)])


def motion_of(pilot: Scripted) -> dict[str, float]:
    played = play(an_env(), pilot, torch.zeros(0, dtype=torch.long))
    return summary(played.motion, torch.ones(2, dtype=torch.bool))


def test_a_robot_that_stands_is_at_rest_and_upright():
    motion = motion_of(Scripted(0.0))
    assert motion["action_rate_rad_s"] == motion["at_torque_limit"] == motion["at_joint_limit"] == 0.0
    assert motion["rest_height"] == pytest.approx(1.0, abs=0.08)  # PD sags by 3 of 55 cm
    assert motion["rest_joint_speed_rad_s"] < 0.02
    # The torques that hold 52 kg on four bent legs.
    assert 3.0 < motion["torque_nm"] < 30.0


def test_shaking_at_rest_is_measured():
    motion = motion_of(Scripted(0.2, -0.2))
    # From +0.2 to -0.2 actions of 0.5 rad each within 20 ms.
    assert motion["action_rate_rad_s"] == pytest.approx(0.4 * 0.5 / 0.02, rel=0.01)
    # It stays on its feet, so that there is a last second to look at.
    assert motion["rest_joint_speed_rad_s"] > 0.1


def test_only_robots_whose_episode_goes_on_count():
    env = an_env()
    meter, waiting = MotionMeter(env), torch.tensor([True, False])
    for step in range(1, 4):
        env.step(torch.full((2, 12), 0.1))
        meter.take(env.state, waiting, step)
    means = meter.means()
    assert set(means) == set(UNITS)
    assert float(means["torque_nm"][0]) > 0.0
    assert bool(means["torque_nm"][1].isnan())
    # Nothing is at rest after three steps.
    assert bool(means["rest_height"].isnan().all())
    assert summary(means, torch.tensor([True, True]))["rest_height"] is None


def test_limits_are_counted_by_joint():
    env = an_env(1)
    meter = MotionMeter(env)
    # Hip abduction ends at 0.72 rad outwards on the left; the others are far from their ends.
    joint_pos = torch.zeros(1, 12)
    joint_pos[0, 0] = meter._range[0, 1] - 0.01
    torque = torch.zeros(1, 12)
    torque[0, :3] = torch.tensor([80.0, -79.5, 70.0])
    meter.take(replace(env.state, joint_pos=joint_pos, joint_torque=torque), torch.tensor([True]), 1)
    means = {name: float(values) for name, values in meter.means().items()}
    assert means["at_joint_limit"] == pytest.approx(1 / 12)
    assert means["at_torque_limit"] == pytest.approx(2 / 12)


def test_crossing_legs_are_measured():
    env = an_env(3)
    joint_pos = torch.tensor(env.robot.default_joint_pos).repeat(3, 1)
    names = list(env.robot.joint_names)
    # Feet stand 0.6 m apart; hips turned inwards bring the second robot's front feet past each other. The third one's
    # left legs walk through each other: front foot far back, hind foot far forward.
    joint_pos[1, [names.index("LF_HAA"), names.index("RF_HAA")]] = torch.tensor([-0.7, 0.7])
    joint_pos[2, [names.index("LF_HFE"), names.index("LH_HFE")]] += torch.tensor([1.2, -1.2])
    assert LegCrossing(env.robot).found(joint_pos.numpy()).tolist() == [False, True, True]
    meter = MotionMeter(env)
    for step in range(1, 11):
        meter.take(replace(env.state, joint_pos=joint_pos), torch.tensor([True, True, False]), step)
    crossed = meter.means()["legs_crossed"]
    assert crossed[:2].tolist() == [0.0, 1.0]
    assert bool(crossed[2].isnan())


def test_a_measured_run_gets_a_card(tmp_path, monkeypatch):
    # Films are tested elsewhere, and take a minute where no GPU draws them.
    monkeypatch.setattr(evaluation, "film", lambda episode, path: path.touch())
    folder = tmp_path / "tiny"
    small = ("--set", "ppo.hidden=[8]", "ppo.num_steps=4", "terrain.variants=1", "terrain.levels=2")
    main(["train", "gap", "--iterations", "1", "--num-envs", "4", "--threads", "1", "--out", str(folder), *small])
    with pytest.raises(ArriveError, match="not measured"):
        write_card(read_run(folder), folder)
    main(["eval", str(folder), "--protocol", "difficulty", "--episodes", "4", "--levels", "1", "--threads", "1"])
    difficulty = json.loads((folder / "difficulty.json").read_text())
    # A fresh policy solves nothing, so there is no motion to tell of; the card says how it fails.
    motion = dict.fromkeys(UNITS, 0.123)
    profile = {"time_s": [0.1], "mean_m_s": [0.5]}
    figures = {"arrival_time_s": [3.0, 4.0, 5.0], "path_length_m": [5.0, 5.0, 5.0], "speed_profile": profile}
    difficulty["policy"]["usage"]["gap"][0] |= figures | {"episodes": 3, "motion": motion}
    (folder / "difficulty.json").write_text(json.dumps(difficulty))
    run = read_run(folder)
    text = write_card(run, folder).read_text()
    for part in ("# tiny", run.record["command"], "| gap | - | - | - |", "| 0.02 m | 0.0% |", "| gap 0.02 | 3 | 0.123"):
        assert part in text
    assert "![curves](curves.png)" in text
    pictures = folder / "pictures" / "difficulty"
    assert {path.stem for path in pictures.glob("*.mp4")} == {path.stem for path in pictures.glob("*.png")}
    for picture in pictures.glob("*.png"):
        assert f"(pictures/difficulty/{picture.name})" in text
