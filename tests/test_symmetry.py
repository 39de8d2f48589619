"""The mirror maps undo themselves and commute with the simulation."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TaskConfig, TerrainConfig
from arrive.env import POLICY, ArriveEnv
from arrive.learning.symmetry import Augmentation, make_mirror
from arrive.presets import PAPER_REWARDS

ACROSS = [1, -1, 1]
"""Reflection of a vector about the x-z plane."""


def two_robots(family: str, value: float) -> ArriveEnv:
    """Two robots on the same tile, which is its own mirror image, undisturbed."""
    config = Config(
        num_envs=2,
        terrain=TerrainConfig(families=(family,), variants=1),
        observation=ObservationConfig(noise=False),
        randomisation=RandomisationConfig(push_speed=0.0),
        task=TaskConfig(rewards=dict(PAPER_REWARDS)),
    )
    nowhere = torch.zeros(2, dtype=torch.long)
    return build_env(config, Placement(values=((value,),), assignment=(nowhere, nowhere)), threads=1)


def mirrored_joints(env: ArriveEnv, values: np.ndarray) -> np.ndarray:
    """By the robot's names, not by the map under test."""
    index = {name: i for i, name in enumerate(env.robot.joint_names)}
    partner = [index[{"L": "R", "R": "L"}[name[0]] + name[1:]] for name in env.robot.joint_names]
    return values[partner] * [-1 if name.endswith("HAA") else 1 for name in env.robot.joint_names]


def start_as_mirror_images(env: ArriveEnv, position: tuple[float, float, float], seed: int) -> None:
    """A robot in a random state near standing there, and its mirror image, with mirrored targets."""
    rng = np.random.default_rng(seed)
    qpos, qvel = np.zeros((2, 19)), np.zeros((2, 18))
    quat = np.array([np.cos(0.3), 0.0, 0.0, np.sin(0.3)]) + rng.normal(0, 0.03, 4)
    qpos[0, :3], qpos[0, 3:7] = position, quat / np.linalg.norm(quat)
    qpos[0, 7:] = env.robot.default_joint_pos + rng.normal(0, 0.1, 12)
    qvel[0] = rng.normal(0, 0.3, 18)
    qpos[1, :7] = qpos[0, :7] * [*ACROSS, 1, -1, 1, -1]
    qpos[1, 7:] = mirrored_joints(env, qpos[0, 7:])
    qvel[1, :6] = qvel[0, :6] * [*ACROSS, -1, 1, -1]
    qvel[1, 6:] = mirrored_joints(env, qvel[0, 6:])
    command = env.task.command
    command.target_w[0] = torch.tensor([2.0, 3.0, 0.7])
    command.target_w[1] = command.target_w[0] * torch.tensor(ACROSS)
    env.physics.reset(torch.arange(2), torch.from_numpy(qpos), torch.from_numpy(qvel))
    env.load_state_dict(env.state_dict())


@pytest.mark.parametrize(
    ("family", "value", "position"),
    [
        ("flat", 0.0, (0.0, 0.03, 0.58)),
        ("pit", 0.4, (1.013, 0.507, 0.58)),  # heights differ between left and right
        ("stairs", 0.1, (0.913, -0.307, 0.68)),  # feet on different treads
        ("gap", 0.6, (0.813, 0.617, 0.58)),
    ],
)
def test_a_mirrored_robot_senses_and_earns_what_the_robot_does_mirrored(family, value, position):
    env = two_robots(family, value)
    start_as_mirror_images(env, position, seed=0)
    mirror, generator = make_mirror(env), torch.Generator().manual_seed(0)
    observation = env.get_observations()[POLICY]
    sides_differ = False
    for _ in range(30):
        image = mirror.observation(observation[:1])
        torch.testing.assert_close(observation[1:], image, atol=1e-3, rtol=0.0)
        heights = env.observer.schema()[-1]
        heights = slice(heights["start"], heights["stop"])
        sides_differ |= bool((observation[0] - observation[1])[heights].abs().max() > 0.1)
        action = 0.6 * torch.randn(1, 12, generator=generator)
        observations, rewards, dones, _ = env.step(torch.cat([action, mirror.action(action)]))
        observation = observations[POLICY]
        assert not dones.any()
        torch.testing.assert_close(rewards[1], rewards[0], atol=1e-3, rtol=1e-3)
    assert sides_differ == (family != "flat"), "the map of the heights was not put to the test"
    assert env.state.foot_contacts.any()


def test_mirror_images_of_mirror_images_are_the_originals():
    env = two_robots("flat", 0.0)
    mirror = make_mirror(env)
    observation, action = torch.randn(5, env.observer.size), torch.randn(5, 12)
    for original, reflect in ((observation, mirror.observation), (action, mirror.action)):
        assert torch.equal(reflect(reflect(original)), original)
        assert not torch.equal(reflect(original), original)


def test_the_default_pose_is_its_own_mirror_image():
    env = two_robots("flat", 0.0)
    default = torch.tensor([env.robot.default_joint_pos])
    assert torch.equal(make_mirror(env).action(default), default)


def test_augmentation_appends_the_mirror_images():
    env = two_robots("flat", 0.0)
    mirror = make_mirror(env)
    double = Augmentation(mirror)
    observation, action = torch.randn(3, env.observer.size), torch.randn(3, 12)
    both, actions = double(env, TensorDict({POLICY: observation}, batch_size=[3]), action)
    assert both.batch_size == (6,)
    assert torch.equal(both[POLICY][:3], observation)
    assert torch.equal(both[POLICY][3:], mirror.observation(observation))
    assert torch.equal(actions, torch.cat([action, mirror.action(action)]))
    assert double(env, None, None) == (None, None)
