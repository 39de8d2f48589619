"""States and disturbances of ANYmal C, for tests of the physics engines."""

import numpy as np
import torch
from torch import Tensor

from arrive.physics import Physics
from arrive.robots import get_robot

ROBOT = get_robot("anymal_c")
DEFAULT = torch.tensor(ROBOT.default_joint_pos)


def standing(n: int, height: float) -> tuple[Tensor, Tensor]:
    """Positions and velocities of robots that stand at their default pose with the base at this height [m]."""
    qpos = torch.zeros(n, 19, dtype=torch.double)
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = height, 1.0, DEFAULT
    return qpos, torch.zeros(n, 18, dtype=torch.double)


def disturb(engine: Physics, step: int, rng: np.random.Generator, num_worlds: int) -> None:
    """Random joint targets; now and then robots move to other worlds and start again, or are pushed."""
    n = engine.num_envs
    if step % 7 == 3:
        ids = torch.from_numpy(np.flatnonzero(rng.random(n) < 0.4))
        engine.place(ids, torch.from_numpy(rng.integers(0, num_worlds, len(ids))))
        qpos, qvel = standing(len(ids), ROBOT.standing_height + 0.05)
        engine.reset(ids, qpos, qvel + torch.from_numpy(rng.normal(0, 0.3, (len(ids), 18))))
    if step % 5 == 2:
        engine.push(torch.tensor([0, n - 1]), torch.from_numpy(rng.normal(0, 0.5, (2, 3))))
    engine.step(DEFAULT + torch.from_numpy(rng.normal(0, 0.5, (n, 12))).float())


def assert_same_reading(first: Physics, second: Physics, envs: list[int] | slice = slice(None)) -> None:
    """What both engines tell of these robots is the same, bit for bit."""
    for name, value in vars(first.read()).items():
        assert torch.equal(value[envs], vars(second.read())[name][envs]), name
