"""The comparison of controller and network: equal observations and equal success rates."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from arrive import cli
from arrive.build import Placement, build_env
from arrive.config import override
from arrive.deployment import Controller
from arrive.deployment.opening import open_policy
from arrive.env import POLICY
from arrive.errors import ArriveError
from arrive.evaluation.arrival import cells_of
from arrive.evaluation.closed_loop import (
    ControlledRobots,
    check_pair,
    compare,
    comparison_summary,
    with_measured_gravity,
)
from arrive.learning.policy import load_policy
from arrive.task.observations import Observer
from arrive.task.rotation import quat_of_yaw, rotate_inverse, yaw_of
from arrive.terrain import FAMILIES
from loading import ROOT
from tiny_runs import train_words

RUN = ROOT / "policies" / "walk"
GRAVITY = slice(6, 9)


@pytest.fixture(scope="module")
def policy():
    torch.set_num_threads(1)
    return load_policy(RUN)


@pytest.fixture(scope="module")
def file():
    return open_policy(str(RUN))


def test_tilt_turns_gravity_and_nothing_else():
    yaw = torch.linspace(-3.0, 3.0, 7, dtype=torch.double)
    quat = quat_of_yaw(yaw)
    down = torch.tensor([0.0, 0.0, -1.0], dtype=torch.double).expand(7, 3)
    measured = down + 0.05 * torch.randn(7, 3, generator=torch.Generator().manual_seed(1)).double()
    tilted = with_measured_gravity(quat, rotate_inverse(quat, down), measured)
    seen = rotate_inverse(tilted, down)
    torch.testing.assert_close(seen, measured / measured.norm(dim=-1, keepdim=True))
    torch.testing.assert_close(yaw_of(tilted), yaw, atol=0.01, rtol=0)
    torch.testing.assert_close(with_measured_gravity(quat, down, down), quat)


def observed(monkeypatch) -> list[np.ndarray]:
    """A list to which every controller adds what it observes."""
    seen, attempt = [], Controller._attempt

    def spy(controller, frame):
        seen.append(controller.observe(frame)[0])
        return attempt(controller, frame)

    monkeypatch.setattr(Controller, "_attempt", spy)
    return seen


def test_each_controller_sees_its_robots_noisy_observation(policy, file, monkeypatch):
    config = override(policy.config, ("num_envs=6", 'terrain.families=["stairs"]', "terrain.variants=2"))
    everyone = torch.arange(6)
    env = build_env(config, Placement(assignment=(0 * everyone, 0 * everyone + 3)), threads=1)
    robots, seen = ControlledRobots(env, file), observed(monkeypatch)
    observation = env.get_observations()[POLICY]
    (grid,) = (slice(term.start, term.stop) for term in file.terms if term.name == "heights")
    compared = 0
    for _ in range(50):
        seen.clear()
        actions = robots.act(observation)
        if len(seen) < 6:  # one toppled, and is not asked any more
            break
        mine = torch.from_numpy(np.stack(seen)).float()
        gravity = observation[:, GRAVITY] / observation[:, GRAVITY].norm(dim=-1, keepdim=True)
        torch.testing.assert_close(mine[:, GRAVITY], gravity, atol=1e-5, rtol=0)
        # The controller leads to targets beyond 5 m in parts, remembers its action as it was before the limits, and
        # cuts heights after the noise instead of before.
        near = observation[:, 9:12].norm(dim=-1) * 2.0 < 5.0
        for same in (slice(0, 6), slice(9, 37)):
            torch.testing.assert_close(mine[near][:, same], observation[near][:, same], atol=1e-4, rtol=0)
        low, high = config.observation.heights.clip
        heights = observation[:, grid] / config.observation.heights.scale
        inside = (low < heights) & (heights < high)
        torch.testing.assert_close(mine[:, grid][inside], observation[:, grid][inside], atol=1e-4, rtol=0)
        compared += 1
        observation = env.step(actions)[0][POLICY]
        if env.log.finished is not None:  # a clock that goes back to zero is a fault to the controller
            break
    assert compared > 20
    assert near.any()
    assert inside.float().mean() > 0.5


def test_controllers_observe_the_ground_around_their_feet(tmp_path, monkeypatch):
    """On steps, with noise within the bounds of training, beside cells that are as noisy as the network's."""
    cli.main(train_words(1, str(tmp_path / "run")))
    cli.main(["export", str(tmp_path / "run"), "-o", str(tmp_path / "robot.onnx")])
    policy, file = load_policy(tmp_path / "run"), open_policy(str(tmp_path / "robot.onnx"))
    config = override(policy.config, ("num_envs=8", 'terrain.families=["steps"]'))
    env = build_env(config, Placement(values=((0.1,),), assignment=(torch.zeros(8).long(),) * 2), threads=1)
    qpos, qvel = torch.zeros(8, 19), torch.zeros(8, 18)
    qpos[:, 0], qpos[:, 1], qpos[:, 2], qpos[:, 3] = 2.0, torch.linspace(-2.0, 2.0, 8), 0.6, 1.0
    qpos[:, 7:] = torch.tensor(env.robot.default_joint_pos)
    env.physics.reset(torch.arange(8), qpos.double(), qvel.double())
    env.load_state_dict(env.state_dict())
    seen, observation, generator = observed(monkeypatch), env.get_observations()[POLICY], torch.Generator()
    robots = ControlledRobots(env, file)
    seen.clear()  # controllers take a trial step while they are built
    robots.act(observation)
    clean = Observer(env.observer.terms, False, env.device).observe(env.state, env.task.command, generator)
    mine = torch.from_numpy(np.stack(seen)).float()
    feet, cells = ((slice(term.start, term.stop), term.scale) for term in file.terms[-2:])
    noise = (mine - clean)[:, feet[0]] / feet[1]
    bound = config.observation.heights.noise
    within = noise.abs() < 1.001 * bound  # others are of neighbouring points, because joints are measured with noise
    assert float(within.float().mean()) > 0.95
    assert float(noise[within].std()) == pytest.approx(bound / 3**0.5, rel=0.15)
    assert float(clean[:, feet[0]].std(1).max()) > bound * feet[1], "the feet stand on flat ground"
    agree = ((mine - observation)[:, cells[0]] / cells[1]).abs() < 1e-4
    assert float(agree.float().mean()) > 0.9


def test_controllers_observe_at_least_half_a_second_of_time_left(policy, file, monkeypatch):
    config = override(policy.config, ("num_envs=1", "terrain.variants=1"))
    env = build_env(config, Placement(assignment=(torch.zeros(1).long(), torch.zeros(1).long())), threads=1)
    robots, told = ControlledRobots(env, file), []
    observe = Controller.observe

    def spy(controller, frame):
        observation, order = observe(controller, frame)
        told.append(order.time_left_s)
        return observation, order

    monkeypatch.setattr(Controller, "observe", spy)
    env.task.command.time_left_s[:] = 1.0
    for _ in range(45):
        env.step(robots.act(env.get_observations()[POLICY]))
    assert told[0] == pytest.approx(1.0)
    assert told[24:] == pytest.approx([0.52, *[0.5] * 20])


@pytest.mark.parametrize("family", ["flat", "rough"])
def test_within_its_limits_the_controller_moves_the_robot_as_the_network_does(family, policy, file, monkeypatch):
    """Without noise, torque limits and hold: until contacts have blown up the rounding of float32, the same motion."""
    monkeypatch.setattr("arrive.deployment.safety.Limits.within_torque", lambda limits, targets, pos, vel: targets)
    unheld = replace(file, task=replace(file.task, reward_window_s=0.0))
    changes = ("num_envs=8", f'terrain.families=["{family}"]', "terrain.variants=2", "observation.noise=false")
    config = override(policy.config, (*changes, "randomisation.push_speed=0"))
    everyone = torch.zeros(8).long()
    first, second = (build_env(config, Placement(assignment=(everyone, everyone)), threads=1) for _ in range(2))
    robots = ControlledRobots(second, unheld)
    observations = [env.get_observations()[POLICY] for env in (first, second)]
    for _ in range(40):
        observations[0] = first.step(policy.act(observations[0]))[0][POLICY]
        observations[1] = second.step(robots.act(observations[1]))[0][POLICY]
    assert float(first.state.joint_vel.abs().max()) > 1.0
    torch.testing.assert_close(second.state.base_pos_w, first.state.base_pos_w, atol=1e-4, rtol=0)


def test_the_controller_arrives_as_often_as_the_network(policy, file):
    """Sixty episodes tell a broken controller; benchmarks/closed_loop.py says how large the difference is."""
    (row,) = compare(policy, file, cells_of(policy.config, [FAMILIES["rough"]], 0), 60, seed=1, threads=1)
    assert row.network.success > 0.8
    assert abs(row.difference) <= 0.1
    assert row.agreed >= 48
    assert f"network {row.network.success:.1%}" in comparison_summary(row)


def test_a_controller_of_another_policy_is_not_compared(policy, file):
    with pytest.raises(ArriveError, match="not the export"):
        check_pair(load_policy(RUN.parent / "gap"), file)
    velocity = replace(file, task=replace(file.task, name="velocity"))
    with pytest.raises(ArriveError, match="no targets"):
        check_pair(policy, velocity)
