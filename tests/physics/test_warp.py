"""The two engines agree: MuJoCo Warp in float32 against MuJoCo's float64, on Warp's CPU device.

Tolerances are those of float32 and of a contact solver that stops after 15 iterations: joint accelerations reach
10,000 rad/s^2, of which float32 resolves about 0.001 at best.
"""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from arrive.actuation import motor_torque
from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.policy import load_policy
from arrive.physics import PhysicsConfig
from arrive.physics.cpu import CpuPhysics
from arrive.physics.options import with_decimation
from arrive.physics.world import compile_world
from arrive.presets import PAPER_REWARDS, robust
from arrive.terrain import FAMILIES, build_tile
from arrive.terrain.tile import MAX_GEOMS
from engines import DEFAULT, ROBOT, assert_same_reading, disturb, standing
from loading import ROOT

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
pytest.importorskip("warp", reason="Warp is not installed")

import warp as wp

from arrive.physics.template import build_template, differing_fields
from arrive.physics.warp import WarpPhysics, _batched_fields
from arrive.physics.warp_contacts import drop_false_contacts

pytestmark = pytest.mark.warp

CPU = torch.device("cpu")
ONE_STEP = PhysicsConfig(decimation=1)
SAMPLES = 6
"""States of every robot that the engines are compared in."""


@cache
def world(family: str, config: PhysicsConfig = ONE_STEP, friction: float = 0.8, payload: float = 3.0) -> mujoco.MjModel:
    kind = FAMILIES[family]
    value = kind.lowest + 0.3 * (kind.highest - kind.lowest)
    tile = build_tile(kind, value, np.random.default_rng(0), "training")
    return compile_world(ROBOT, tile, config, friction, payload, places=MAX_GEOMS)


def pair(families: tuple[str, ...], num_envs: int, config: PhysicsConfig = ONE_STEP) -> tuple[CpuPhysics, WarpPhysics]:
    """Both engines with the environments dealt to the families, robots standing."""
    worlds = [world(name, config) for name in families]
    engines = (
        CpuPhysics(ROBOT, worlds, config, num_envs, 1),
        WarpPhysics(ROBOT, worlds, config, num_envs, CPU),
    )
    everyone = torch.arange(num_envs)
    for engine in engines:
        engine.place(everyone, everyone % len(families))
        engine.reset(everyone, *standing(num_envs, ROBOT.standing_height))
    return engines


def stumble(engine: CpuPhysics, steps: int, rng: np.random.Generator) -> Tensor:
    """Walk at random for some physics steps; the next joint targets."""
    for _ in range(steps):
        targets = DEFAULT + torch.from_numpy(rng.normal(0, 0.4, (engine.num_envs, 12))).float()
        for _ in range(4):
            engine.step(targets)
    return targets


class TestAgreement:
    @pytest.mark.parametrize("family", FAMILIES)
    def test_the_same_step_from_the_same_state(self, family):
        """Robots that stumble over the tile: 1 physics step from each of 96 states with contacts.

        Median and 90 % of the largest difference per robot: 0.05 and 1 m/s^2 or rad/s^2 (measured 0.003 and 0.02);
        torques within 1e-3 N m, foot velocities within 1e-4 m/s. Contacts are the same, but on a height field, where
        Warp keeps at most 4 per pair of geoms and its normals differ near edges: there the same bodies touch.
        """
        reference, engine = pair((family,), 16)
        rng = np.random.default_rng(1)
        qpos, qvel = standing(16, ROBOT.standing_height + 0.02)
        qvel[:, :2] = torch.from_numpy(rng.uniform(-1.5, 1.5, (16, 2)))
        reference.reset(torch.arange(16), qpos, qvel)
        differences, touching = [], 0
        for _ in range(SAMPLES):
            targets = stumble(reference, 12, rng)
            engine.load_state_dict(reference.state_dict())
            for each in (reference, engine):
                each.step(targets)
            expected, seen = reference.read(), engine.read()
            accelerations = [each.state_dict()["qacc_warmstart"].double() for each in (reference, engine)]
            differences.append((accelerations[0] - accelerations[1]).abs().amax(-1))
            touching += int((expected.foot_contacts > 0).sum())
            torch.testing.assert_close(seen.joint_torque, expected.joint_torque, atol=1e-3, rtol=0.0)
            torch.testing.assert_close(seen.foot_vel_w, expected.foot_vel_w, atol=1e-4, rtol=0.0)
            assert torch.equal(seen.crash_contacts > 0, expected.crash_contacts > 0)
            assert torch.equal(seen.collision_contacts, expected.collision_contacts)
            if family == "rough":
                assert torch.equal(seen.foot_contacts > 0, expected.foot_contacts > 0)
            else:
                assert torch.equal(seen.foot_contacts, expected.foot_contacts)
                assert torch.equal(seen.crash_contacts, expected.crash_contacts)
        assert touching > 50
        largest = torch.cat(differences)
        assert float(largest.median()) < 0.05
        assert float(largest.quantile(0.9)) < (20.0 if family == "rough" else 1.0)

    @pytest.mark.parametrize("kind", ["dc", "ideal"])
    def test_the_motor_gives_the_torque_of_the_formula(self, kind):
        """Errors to 4 rad and speeds to 15 rad/s, far into both limits, within 1e-3 N m."""
        n, rng = 64, np.random.default_rng(0)
        config = replace(ONE_STEP, motor=kind)
        engine = WarpPhysics(ROBOT, [world("flat", config)], config, n, CPU)
        qpos, qvel = standing(n, 5.0)
        error, speed = rng.uniform(-4, 4, (n, 12)), rng.uniform(-15, 15, (n, 12))
        qvel[:, 6:] = torch.from_numpy(speed)
        engine.reset(torch.arange(n), qpos, qvel)
        engine.step((qpos[:, 7:] + torch.from_numpy(error)).float())
        expected = motor_torque(ROBOT.motors[0], error, speed, kind)
        np.testing.assert_allclose(engine.read().joint_torque, expected, atol=1e-3)

    def test_contacts_are_told_apart_by_body(self):
        """On its back the base touches, on its feet the feet do, on its knees the four thighs."""
        _, engine = pair(("flat",), 3)
        qpos, qvel = standing(3, ROBOT.standing_height)
        qpos[1, 2:7] = torch.tensor([0.085, 0.0, 1.0, 0.0, 0.0])
        qpos[2, 2], qpos[2, 7:] = 0.335, torch.tensor([0.0, 0.0, -2.5, 0.0, 0.0, 2.5] * 2)
        engine.reset(torch.arange(3), qpos, qvel)
        engine.step(qpos[:, 7:].float())
        readings = engine.read()
        assert (readings.crash_contacts > 0).tolist() == [False, True, False]
        assert readings.foot_contacts.bool().all(-1).tolist() == [True, False, False]
        assert readings.collision_contacts.tolist() == [0.0, 0.0, 4.0]

    def test_a_contact_off_the_surface_of_a_height_field_is_dropped(self):
        """A standing robot has contacts with a rough field; those lifted off its surface become inactive."""
        _, engine = pair(("rough",), 2)
        engine.reset(torch.arange(2), *standing(2, ROBOT.standing_height - 0.005))
        engine.step(DEFAULT.expand(2, 12))
        contact, count = engine._data.contact, int(engine._data.nacon.numpy()[0])
        dist, pos = wp.to_torch(contact.dist)[:count], wp.to_torch(contact.pos)[:count]
        assert count > 4
        before = dist.clone()
        drop_false_contacts(engine._model, engine._data)
        assert torch.equal(dist, before)
        pos[0, 2] += 0.01
        pos[1, 2] -= 0.01
        drop_false_contacts(engine._model, engine._data)
        assert dist[:2].tolist() == [1.0, 1.0]
        assert torch.equal(dist[2:], before[2:])

    def test_walking_on_a_height_field_throws_no_robot(self):
        """No joint gains more than 10 rad/s on MuJoCo's in a physics step from what Warp takes for contacts near edges.

        Compared in 20 states each of 64 robots that walk on rough ground and have not fallen.
        """
        reference, engine = pair(("rough",), 64)
        rng = np.random.default_rng(5)
        qpos, qvel = standing(64, ROBOT.standing_height + 0.02)
        qpos[:, :2] = torch.from_numpy(rng.uniform(-2, 2, (64, 2)))
        qvel[:, :2] = torch.from_numpy(rng.uniform(-1, 1, (64, 2)))
        reference.reset(torch.arange(64), qpos, qvel)
        for _ in range(20):
            targets = DEFAULT + torch.from_numpy(rng.normal(0, 0.15, (64, 12))).float()
            for _ in range(4):
                reference.step(targets)
            engine.load_state_dict(reference.state_dict())
            for each in (reference, engine):
                each.step(targets)
            upright = reference.read().base_pos_w[:, 2] > 0.35
            gained = engine.read().joint_vel.abs().amax(-1) - reference.read().joint_vel.abs().amax(-1)
            assert float(gained[upright].max()) < 10.0


class TestWorlds:
    def test_every_difference_between_worlds_is_found(self):
        worlds = [world("flat"), world("slope", friction=0.5), world("rough", payload=-4.0)]
        template = build_template(ROBOT, worlds, ONE_STEP)
        tables = differing_fields(template, worlds, _batched_fields())
        assert {"geom_pos", "geom_quat", "geom_size", "geom_aabb", "geom_rbound", "geom_dataid"} <= set(tables)
        assert {"geom_friction", "body_mass", "body_inertia", "body_subtreemass", "dof_invweight0"} <= set(tables)
        assert not {name for name in tables if name.startswith(("jnt_", "actuator_gain", "actuator_bias"))}
        base = template.body(ROBOT.base_body).id
        assert np.diff(tables["body_mass"][:, base]).tolist() == pytest.approx([0.0, -7.0])

    def test_worlds_that_differ_in_unsupported_fields_are_an_error(self):
        worlds = [world("flat"), world("flat", replace(ONE_STEP, motor="ideal"))]
        template = build_template(ROBOT, worlds, ONE_STEP)
        with pytest.raises(ArriveError, match=r"worlds differ in actuator_\w+, which MuJoCo Warp cannot vary"):
            differing_fields(template, worlds, _batched_fields())
        with pytest.raises(ArriveError, match="another value of option impratio"):
            WarpPhysics(ROBOT, [world("flat")], replace(ONE_STEP, impratio=3.0), 1, CPU)

    def test_robots_come_to_rest_on_the_ground_of_their_own_world(self):
        """After moving to another world each rests as high as with MuJoCo, within 1 mm, on a height field 1 cm."""
        families = ("flat", "rough", "pit")
        config = PhysicsConfig()
        engines = pair(families, 10, config)
        places = torch.from_numpy(np.random.default_rng(3).permutation(10))
        qpos, qvel = standing(10, 0.0)
        qpos[:, 0], qpos[:, 2] = 2.2, ROBOT.standing_height + 0.05
        heights = []
        for engine in engines:
            engine.place(torch.arange(10), places % len(families))
            for env_id in range(10):
                qpos[env_id, 2] = ROBOT.standing_height + 0.02 + ground(engine.model_of_env(env_id), 2.2)
            engine.reset(torch.arange(10), qpos, qvel)
            for _ in range(40):
                engine.step(DEFAULT.expand(10, 12))
            heights.append(engine.read().base_pos_w[:, 2])
        assert heights[0].unique().numel() >= len(families)
        tolerance = torch.where(places % len(families) == families.index("rough"), 0.01, 0.001)
        assert bool(((heights[1] - heights[0]).abs() < tolerance).all()), heights

    def test_friction_and_payload_are_each_robots_own(self):
        """A robot thrown along the ground slides farther where friction is low, as with MuJoCo within 1.5 %."""
        config = PhysicsConfig()
        worlds = [world("flat", config, friction, payload) for friction in (0.3, 1.0) for payload in (-5.0, 5.0)]
        ways = []
        for engine in (CpuPhysics(ROBOT, worlds, config, 4, 1), WarpPhysics(ROBOT, worlds, config, 4, CPU)):
            engine.place(torch.arange(4), torch.arange(4))
            qpos, qvel = standing(4, ROBOT.standing_height)
            qvel[:, 0] = 1.5
            engine.reset(torch.arange(4), qpos, qvel)
            for _ in range(20):
                engine.step(DEFAULT.expand(4, 12))
            ways.append(engine.read().base_pos_w[:, 0])
        assert float(ways[0][:2].min()) > float(ways[0][2:].max()) + 0.05
        torch.testing.assert_close(ways[1], ways[0], rtol=0.015, atol=0.0)


def ground(model: mujoco.MjModel, x: float) -> float:
    """Highest ground under a robot that stands at (x, 0), found by rays [m]."""
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    mujoco.mj_forward(model, data)
    group = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    hits = []
    for dx in np.linspace(-0.5, 0.5, 11):
        for dy in np.linspace(-0.4, 0.4, 9):
            start = np.array([x + dx, dy, 10.0])
            far = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), group, 1, -1, np.zeros(1, np.int32))
            hits.append(10.0 - far)
    return max(hits)


MIXED = ("flat", "rough", "stairs", "pit")


class TestEngine:
    def test_a_saved_engine_goes_on_the_same(self):
        """Bit for bit on the CPU device."""
        engines = [pair(MIXED, 8, PhysicsConfig())[1] for _ in range(2)]
        rng, other_rng = np.random.default_rng(0), np.random.default_rng(0)
        for step in range(12):
            disturb(engines[0], step, rng, len(MIXED))
        engines[1].load_state_dict(engines[0].state_dict())
        other_rng.bit_generator.state = rng.bit_generator.state
        for step in range(12, 24):
            for engine, chance in zip(engines, (rng, other_rng), strict=True):
                disturb(engine, step, chance, len(MIXED))
        assert_same_reading(*engines)
        assert engines[0].read().foot_contacts.any()

    def test_long_steps_are_those_of_an_engine_made_for_them(self):
        """And back again. Bit for bit on the CPU device."""
        standard = PhysicsConfig()
        changed = WarpPhysics(ROBOT, [world.__wrapped__("flat", standard)], standard, 4, CPU)
        for config in (with_decimation(standard, 2), standard):
            changed.set_decimation(config.decimation)
            made = WarpPhysics(ROBOT, [world.__wrapped__("flat", config)], config, 4, CPU)
            for engine in (changed, made):
                engine.reset(torch.arange(4), *standing(4, ROBOT.standing_height))
                for step in range(8):
                    engine.step(DEFAULT.expand(4, 12) + 0.1 * (step % 3 - 1))
            assert_same_reading(changed, made)
            assert changed.state_dict()["time"].tolist() == pytest.approx(4 * [0.16])

    @pytest.mark.parametrize("speed", [float("nan"), 1e12])
    def test_a_robot_that_diverges_is_reported_and_harms_no_other(self, speed):
        healthy, faulty = (pair(MIXED, 8, PhysicsConfig())[1] for _ in range(2))
        others = [0, 1, 2, 4, 5, 6, 7]
        for engine in (healthy, faulty):
            rng = np.random.default_rng(0)
            for step in range(6):
                if step == 3 and engine is faulty:
                    engine.push(torch.tensor([3]), torch.full((1, 3), speed, dtype=torch.double))
                engine.step(DEFAULT + torch.from_numpy(rng.normal(0, 0.3, (8, 12))).float())
                assert engine.read().finite.tolist() == [
                    not (engine is faulty and step >= 3 and i == 3) for i in range(8)
                ]
        assert_same_reading(healthy, faulty, others)
        for engine in (healthy, faulty):
            engine.reset(torch.tensor([3]), *standing(1, ROBOT.standing_height))
            engine.step(DEFAULT.expand(8, 12))
        assert faulty.read().finite.all()
        assert_same_reading(healthy, faulty)

    def test_an_inactive_robot_stays_where_it_was(self):
        _, engine = pair(MIXED, 4)
        engine.deactivate(torch.tensor([2]))
        before = engine.state_dict()
        for _ in range(5):
            engine.step(DEFAULT.expand(4, 12) + 0.3)
        after = engine.state_dict()
        assert torch.equal(after["qpos"][2], before["qpos"][2])
        assert torch.equal(after["qvel"][2], before["qvel"][2])
        assert not torch.equal(after["qpos"][1], before["qpos"][1])

    def test_contacts_without_room_are_an_error_or_a_divergence(self):
        """Four feet on the ground and room for three contacts: the shared list is full, and every robot's own too."""
        config = replace(ONE_STEP, max_contacts=3)
        engine = WarpPhysics(ROBOT, [world("flat", config)], config, 2, CPU)
        everyone = torch.arange(2)
        engine.reset(everyone, *standing(2, 3.0))
        engine.step(DEFAULT.expand(2, 12))
        assert engine.read().finite.all()
        engine.state_dict()
        qpos, qvel = standing(2, ROBOT.standing_height)
        qpos[1, 2] = 3.0
        engine.reset(everyone, qpos - 0.003 * torch.eye(19)[2].double(), qvel)
        engine.step(DEFAULT.expand(2, 12))
        assert engine.read().finite.tolist() == [True, True]
        engine.reset(everyone, *standing(2, ROBOT.standing_height - 0.003))
        engine.step(DEFAULT.expand(2, 12))
        with pytest.raises(ArriveError, match=r"set physics\.max_contacts to 6 or more"):
            engine.state_dict()


def an_env(engine: str) -> ArriveEnv:
    config = Config(
        num_envs=10,
        physics=PhysicsConfig(engine=engine),
        terrain=TerrainConfig(families=tuple(FAMILIES), levels=2, variants=1),
        observation=ObservationConfig(noise=False),
        randomisation=RandomisationConfig(push_speed=0.0),
        task=replace(robust().task, rewards=PAPER_REWARDS),
    )
    everyone = torch.arange(10)
    return build_env(config, Placement(assignment=(everyone, torch.zeros(10, dtype=torch.long))), threads=1)


def test_the_same_observation_and_reward_for_the_same_state():
    """Through the whole environment, on every terrain: within 1e-4 of the scaled observation."""
    reference, env = an_env("mujoco"), an_env("warp")
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        reference.step(0.3 * torch.randn(10, 12, generator=generator))
    env.load_state_dict(reference.state_dict())
    torch.testing.assert_close(
        env.get_observations()[POLICY], reference.get_observations()[POLICY], atol=1e-4, rtol=0.0
    )
    actions = 0.3 * torch.randn(10, 12, generator=generator)
    (seen, earned, ended, _), (expected, due, over, _) = (each.step(actions) for each in (env, reference))
    assert torch.equal(ended, over)
    # After a policy step of four physics steps contacts have amplified float32's rounding.
    assert float((seen[POLICY] - expected[POLICY]).abs().median()) < 1e-4
    assert float((earned - due).abs().median()) < 1e-3


def test_every_tensor_of_a_step_says_its_device():
    """With torch's default device set to one without memory, a tensor that does not name its own cannot be used."""
    env = an_env("warp")
    with torch.device("meta"):
        for _ in range(3):
            observation, reward, _, _ = env.step(torch.zeros(10, 12, device="cpu"))
        env._reset(torch.arange(10, device="cpu"), first=False)
        state = env.state_dict()
        env.load_state_dict(state)
        observation = env.get_observations()[POLICY]
    assert observation.device.type == reward.device.type == "cpu"


def returns(engine: str, episodes: int) -> tuple[Tensor, Tensor]:
    """Return and arrival of the first episode of each robot, walking on flat ground by a trained policy."""
    policy = load_policy(ROOT / "policies" / "walk")
    config = replace(policy.config, num_envs=episodes, physics=replace(policy.config.physics, engine=engine))
    nowhere = torch.zeros(episodes, dtype=torch.long)
    env = build_env(config, Placement(assignment=(nowhere, nowhere)), threads=1)
    total, arrived = torch.zeros(episodes), torch.zeros(episodes, dtype=torch.bool)
    running = torch.ones(episodes, dtype=torch.bool)
    observation = env.get_observations()[POLICY]
    while running.any():
        observations, reward, done, _ = env.step(policy.act(observation))
        observation = observations[POLICY]
        total += reward * running
        ended = running & done.bool()
        arrived |= ended & env.log.success
        running &= ~ended
    return total, arrived


@pytest.mark.slow
def test_a_policy_earns_as_much_with_both_engines():
    """200 episodes each: mean return and arrival within 3 standard errors of their difference."""
    (first, first_arrived), (second, second_arrived) = (returns(engine, 200) for engine in ("mujoco", "warp"))
    for a, b in ((first, second), (first_arrived.float(), second_arrived.float())):
        print(f"mujoco {a.mean():.4f} +- {a.std() / 200**0.5:.4f}, warp {b.mean():.4f} +- {b.std() / 200**0.5:.4f}")
        assert abs(float(a.mean() - b.mean())) <= 3.0 * float((a.var() / 200 + b.var() / 200).sqrt())
