"""Controllers of a small untrained policy, and measurements of a standing robot."""

import dataclasses

import numpy as np
import torch

from arrive.build import Placement, build_env
from arrive.config import Config, override
from arrive.deployment import Controller, GridHeights, Joystick, Sensors
from arrive.presets import get_preset
from arrive.task.heights import HeightGrid
from arrive.terrain import FAMILIES

DT = 0.02
AHEAD = Joystick(1.0, 0.0)
CONFIG = override(
    get_preset("robust"),
    (
        "num_envs=2",
        "ppo.num_steps=2",
        "terrain.levels=1",
        "terrain.variants=1",
        "observation.noise=false",
        "randomisation.push_speed=0",
    ),
)

POINTS = len(HeightGrid(CONFIG.observation.heights).points)


def an_env(family: str):
    """Robots on the family's hardest level, without noise and pushes."""
    terrain = dataclasses.replace(CONFIG.terrain, families=(family,))
    config: Config = dataclasses.replace(CONFIG, num_envs=4, terrain=terrain)
    assignment = (torch.zeros(4, dtype=torch.long), torch.zeros(4, dtype=torch.long))
    return build_env(config, Placement(values=((FAMILIES[family].highest,),), assignment=assignment), threads=1)


def sensors_of(state, i: int, time_s: float) -> Sensors:
    """What robot i would measure."""
    names = ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b")
    return Sensors(**{name: getattr(state, name)[i].numpy() for name in names}, time_s=time_s)


def standing(controller: Controller, now: float, **changes) -> Sensors:
    """The measurements of a robot that stands at the origin and looks along x."""
    values = {
        "joint_pos": np.array(controller.policy.robot.default_joint_pos_rad),
        "joint_vel": np.zeros(12),
        "base_pos_w": np.array([0.0, 0.0, 0.5]),
        "base_quat_w": np.array([1.0, 0.0, 0.0, 0.0]),
        "base_lin_vel_b": np.zeros(3),
        "base_ang_vel_b": np.zeros(3),
        "time_s": now,
    }
    return Sensors(**values | changes)


def flat(time_s: float) -> GridHeights:
    return GridHeights(np.zeros(POINTS), time_s)


def step(controller: Controller, now: float, goal=AHEAD, terrain=None, **changes):
    """One step of a standing robot; what it returns is checked against what no command may leave."""
    command = controller.step(standing(controller, now, **changes), goal, terrain or flat(now), now)
    assert_safe(controller, command)
    return command


def assert_safe(controller, command):
    low, high = np.array(controller.policy.robot.joint_limits_rad).T
    assert command.targets.shape == (12,)
    assert np.isfinite(command.targets).all()
    assert (command.targets >= low).all()
    assert (command.targets <= high).all()
