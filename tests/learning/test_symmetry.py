"""Reflections are their own inverse and agree with the simulation; symmetric networks are equivariant.

The left-right reflection, which networks do not use, tests that the environment treats both sides alike.
"""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig
from arrive.env import POLICY, ArriveEnv
from arrive.learning.networks import Network
from arrive.learning.symmetry import make_reflections
from arrive.presets import PAPER_REWARDS
from arrive.task.final import FinalConfig
from arrive.task.heights import FootHeightsConfig

ACROSS = [1, -1, 1]
"""Reflection of a vector about the x-z plane."""


def two_robots(family: str, value: float, robot: str = "anymal_c", feet: bool = False) -> ArriveEnv:
    """Two robots on the same tile, which is its own mirror image, undisturbed. With `feet` they see foot heights."""
    config = Config(
        num_envs=2,
        robot=robot,
        terrain=TerrainConfig(families=(family,), variants=1),
        observation=ObservationConfig(noise=False, foot_heights=FootHeightsConfig(enabled=feet)),
        randomisation=RandomisationConfig(push_speed=0.0),
        task=FinalConfig(rewards=PAPER_REWARDS),
    )
    nowhere = torch.zeros(2, dtype=torch.long)
    return build_env(config, Placement(values=((value,),), assignment=(nowhere, nowhere)), threads=1)


def mirrored_joints(env: ArriveEnv, values: np.ndarray) -> np.ndarray:
    index = {name: i for i, name in enumerate(env.robot.joint_names)}
    partner = [index[{"L": "R", "R": "L"}[name[0]] + name[1:]] for name in env.robot.joint_names]
    return values[..., partner] * [-1.0 if name.endswith("HAA") else 1.0 for name in env.robot.joint_names]


def mirrored_observation(env: ArriveEnv, observation: Tensor) -> Tensor:
    """By the labels of the entries."""
    values, image = observation.double().numpy(), np.empty(observation.shape)
    for row in env.observer.schema():
        part, labels = slice(row["start"], row["stop"]), row["labels"]
        term = values[:, part]
        if labels == list(env.robot.joint_names):
            image[:, part] = mirrored_joints(env, term)
        elif row["name"] == "heights":
            cells = [tuple(map(float, label.strip("()").split(","))) for label in labels]
            image[:, part] = term[:, [cells.index((x, -y)) for x, y in cells]]
        elif labels == ["x", "y", "z"]:
            image[:, part] = term * (np.negative(ACROSS) if row["name"] == "base_ang_vel" else ACROSS)
        else:
            assert row["name"] == "time_left"
            image[:, part] = term
    return torch.from_numpy(image).float()


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
def test_a_mirrored_robot_has_mirrored_observations_and_equal_rewards(family, value, position):
    env = two_robots(family, value)
    start_as_mirror_images(env, position, seed=0)
    generator = torch.Generator().manual_seed(0)
    observation = env.get_observations()[POLICY]
    sides_differ = touched = False
    for _ in range(30):
        image = mirrored_observation(env, observation[:1])
        torch.testing.assert_close(observation[1:], image, atol=1e-3, rtol=0.0)
        heights = env.observer.schema()[-1]
        heights = slice(heights["start"], heights["stop"])
        sides_differ |= bool((observation[0] - observation[1])[heights].abs().max() > 0.1)
        action = 0.6 * torch.randn(1, 12, generator=generator)
        mirrored = torch.from_numpy(mirrored_joints(env, action.numpy())).float()
        observations, rewards, dones, _ = env.step(torch.cat([action, mirrored]))
        observation = observations[POLICY]
        touched |= bool(env.state.foot_contacts.any())
        assert not dones.any()
        torch.testing.assert_close(rewards[1], rewards[0], atol=1e-3, rtol=1e-3)
    assert sides_differ == (family != "flat"), "the map of the heights was not put to the test"
    assert touched


def test_a_reversed_robot_has_reversed_observations():
    """Front-back reflection of states and of the pit's ground, whose image it is, before anything moves."""
    env = two_robots("pit", 0.4, feet=True)
    rng = np.random.default_rng(3)
    qpos, qvel = np.zeros((2, 19)), rng.normal(0.0, 0.3, (2, 18))
    quat = np.array([np.cos(0.3), 0.05, -0.02, np.sin(0.3)])
    qpos[0, :3], qpos[0, 3:7] = (1.013, 0.507, 0.58), quat / np.linalg.norm(quat)
    qpos[0, 7:] = env.robot.default_joint_pos + rng.normal(0, 0.1, 12)
    index = {name: i for i, name in enumerate(env.robot.joint_names)}
    partner = [index[name[0] + {"F": "H", "H": "F"}[name[1]] + name[2:]] for name in env.robot.joint_names]
    signs = np.array([1 if name.endswith("HAA") else -1 for name in env.robot.joint_names])
    # A reflection in x turns a rotation about x into itself and those about y and z into their inverses.
    qpos[1, :7] = qpos[0, :7] * [-1, 1, 1, 1, 1, -1, -1]
    qpos[1, 7:], qvel[1, 6:] = qpos[0, 7:][partner] * signs, qvel[0, 6:][partner] * signs
    qvel[1, :6] = qvel[0, :6] * [-1, 1, 1, 1, -1, -1]
    env.task.command.target_w[0] = torch.tensor([2.0, 3.0, 0.7])
    env.task.command.target_w[1] = torch.tensor([-2.0, 3.0, 0.7])
    env.physics.reset(torch.arange(2), torch.from_numpy(qpos), torch.from_numpy(qvel))
    env.load_state_dict(env.state_dict())
    observation = env.get_observations()[POLICY]
    (reverse,) = make_reflections(env)
    torch.testing.assert_close(observation[1:], reverse.observation(observation[:1]), atol=1e-5, rtol=0.0)
    around_feet = next(row for row in env.observer.schema() if row["name"] == "foot_heights")
    for part in (slice(0, around_feet["start"]), slice(around_feet["start"], around_feet["stop"])):
        assert (observation[0] - observation[1])[part].abs().max() > 0.1


def test_a_reflection_of_a_reflection_is_the_original():
    env = two_robots("flat", 0.0)
    (reflection,) = make_reflections(env)
    observation, action = torch.randn(5, env.observer.size), torch.randn(5, 12)
    for original, reflect in ((observation, reflection.observation), (action, reflection.action)):
        assert torch.equal(reflect(reflect(original)), original)
        assert not torch.equal(reflect(original), original)


def test_the_default_pose_is_its_own_image():
    env = two_robots("flat", 0.0)
    default = torch.tensor([env.robot.default_joint_pos])
    (reflection,) = make_reflections(env)
    assert torch.equal(reflection.action(default), default)


def test_a_robot_that_is_not_symmetric_front_to_back_has_no_reflection():
    env = two_robots("flat", 0.0, robot="go2")
    assert make_reflections(env) == ()


def network(env: ArriveEnv, outputs: int, **settings) -> Network:
    sample = TensorDict({POLICY: torch.zeros(1, env.observer.size)}, batch_size=[1])
    settings = {"hidden_dims": [32, 32], "reflections": make_reflections(env)} | settings
    return Network(sample, {"actor": [POLICY]}, "actor", outputs, **settings)


def answers(model: Network, observation: Tensor) -> Tensor:
    return model(TensorDict({POLICY: observation}, batch_size=[len(observation)]))


@pytest.mark.parametrize("noisy", [True, False])
def test_symmetric_networks_answer_a_reflected_robot_with_the_reflected_action_and_the_same_value(noisy):
    env = two_robots("flat", 0.0)
    distribution = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "std_type": "log"}
    actor = network(env, 12, distribution_cfg=distribution if noisy else None)
    critic = network(env, 1)
    observation = torch.randn(64, env.observer.size)
    (reflection,) = make_reflections(env)
    image, expected = reflection.observation(observation), reflection.action(answers(actor, observation))
    if noisy:
        torch.testing.assert_close(answers(actor, image), expected)
    torch.testing.assert_close(answers(critic, image), answers(critic, observation))
    plain = network(env, 12, distribution_cfg=distribution, reflections=())
    assert not torch.allclose(answers(plain, image), expected, atol=0.01)


def test_observations_reflected_once_give_the_same_bits():
    env = two_robots("flat", 0.0)
    distribution = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "std_type": "log"}
    observation = torch.randn(64, env.observer.size)
    observations = TensorDict({POLICY: observation}, batch_size=[64])
    for model in (network(env, 12, distribution_cfg=distribution), network(env, 1)):
        once = model.reflect_once(observations)
        assert not torch.equal(once[POLICY], observation)
        assert torch.equal(model(once), model(observations))
    assert network(env, 1, reflections=()).reflect_once(observations) is observations


def test_a_symmetric_network_finds_its_maps_in_its_file():
    env = two_robots("flat", 0.0)
    distribution = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "std_type": "log"}
    first = network(env, 12, distribution_cfg=distribution)
    second = network(env, 12, distribution_cfg=distribution, reflections=1)
    second.load_state_dict(first.state_dict())
    observation = torch.randn(8, env.observer.size)
    assert torch.equal(answers(first, observation), answers(second, observation))
