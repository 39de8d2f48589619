"""The CPU engine: accurate, bit-identical at any number of threads, resumable, and robust to diverged robots."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
import torch
from mujoco.batch import SimulationError

from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.fields import check_fields
from arrive.physics import PhysicsConfig
from arrive.physics.cpu import CpuPhysics
from arrive.physics.options import with_decimation
from arrive.physics.world import compile_world
from arrive.presets import PAPER_REWARDS
from arrive.robots import Robot
from arrive.task.final import FinalConfig
from arrive.task.rewards import Approach, Cost, Reward
from arrive.terrain import FAMILIES, build_tile
from arrive.terrain.tile import MAX_GEOMS
from engines import DEFAULT, ROBOT, assert_same_reading, disturb, standing

STATES = ("qpos", "qvel", "qacc_warmstart", "ctrl", "time")


@cache
def world(family: str = "flat") -> mujoco.MjModel:
    kind = FAMILIES[family]
    tile = build_tile(kind, (kind.lowest + kind.highest) / 2, np.random.default_rng(0), "training")
    return compile_world(ROBOT, tile, PhysicsConfig(), places=MAX_GEOMS)


def an_engine(num_envs: int, families: tuple[str, ...] = ("flat",), threads: int = 1) -> CpuPhysics:
    engine = CpuPhysics(ROBOT, [world(name) for name in families], PhysicsConfig(), num_envs, threads)
    everyone = torch.arange(num_envs)
    engine.place(everyone, everyone % len(families))
    engine.reset(everyone, *standing(num_envs, ROBOT.standing_height))
    return engine


def momentum(engine: CpuPhysics, env_id: int) -> tuple[np.ndarray, np.ndarray]:
    """Linear [kg m/s] and angular momentum about the centre of mass [kg m^2/s] of a robot."""
    model, state = engine.model_of_env(env_id), engine.state_dict()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state["qpos"][env_id], state["qvel"][env_id]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    base = model.body(ROBOT.base_body).id
    return data.subtree_linvel[base] * model.body_subtreemass[base], data.subtree_angmom[base].copy()


def assert_same(first: CpuPhysics, second: CpuPhysics, envs: list[int] | slice = slice(None)) -> None:
    a, b = first.state_dict(), second.state_dict()
    for name in STATES:
        assert torch.equal(a[name][envs], b[name][envs]), name
    assert_same_reading(first, second, envs)


class TestAccuracy:
    def test_a_resting_robot_neither_sinks_nor_creeps(self):
        """Less than 1 mm deep, 1.5 mm/s of the base, 2 mm/s of the feet, in soft contacts after settling for 3 s."""
        engine = an_engine(1)
        for _ in range(150):
            engine.step(DEFAULT[None])
        before = engine.read()
        for _ in range(100):
            engine.step(DEFAULT[None])
            readings = engine.read()
            assert float(readings.foot_vel_w.norm(dim=-1).max()) < 0.002
            assert float(readings.base_lin_vel_w.norm()) < 0.005
            assert bool((readings.foot_contacts == 1.0).all())
        assert float((readings.base_pos_w - before.base_pos_w).norm()) < 2 * 0.0015
        model = engine.model_of_env(0)
        data = mujoco.MjData(model)
        data.qpos[:] = engine.state_dict()["qpos"][0]
        mujoco.mj_forward(model, data)
        depth = [0.03 - data.site(site).xpos[2] for site in ROBOT.foot_sites]
        assert min(depth) > 0.0
        assert max(depth) < 0.001
        assert float(readings.crash_contacts) == float(readings.collision_contacts) == 0.0

    def test_momentum_in_free_flight(self):
        """Motors act inside the robot: in half a second only gravity changes its momentum.

        A 52 kg robot thrown at about 1 m/s and turning at 1 rad/s keeps its momentum within 1 kg m/s (2 %) and its
        angular momentum within 0.15 kg m^2/s (3 %) while its legs kick at the limits of the motors.
        """
        engine, rng = an_engine(4), np.random.default_rng(0)
        qpos, qvel = standing(4, 20.0)
        qpos[:, 7:] += torch.from_numpy(rng.normal(0, 0.2, (4, 12)))
        qvel[:, :6] = torch.from_numpy(rng.normal(0, 1.0, (4, 6)))
        engine.reset(torch.arange(4), qpos, qvel)
        before = [momentum(engine, i) for i in range(4)]
        targets = DEFAULT + torch.from_numpy(rng.normal(0, 0.4, (4, 12))).float()
        for _ in range(25):
            engine.step(targets)
        moved = (engine.state_dict()["qpos"][:, 7:] - qpos[:, 7:]).abs().amax(-1)
        assert bool((moved > 0.3).all())
        mass = world().body_subtreemass[world().body(ROBOT.base_body).id]
        for i in range(4):
            linear, angular = momentum(engine, i)
            np.testing.assert_allclose(linear - before[i][0], [0.0, 0.0, -9.81 * mass * 0.5], atol=1.0)
            np.testing.assert_allclose(angular, before[i][1], atol=0.15)
        assert not engine.read().foot_contacts.any()

    def test_contacts_are_told_apart_by_body(self):
        """On its back the base touches, on its feet the feet do, on its knees the four thighs."""
        engine = an_engine(3)
        qpos, qvel = standing(3, ROBOT.standing_height)
        qpos[1, 2:7] = torch.tensor([0.085, 0.0, 1.0, 0.0, 0.0])
        qpos[2, 2], qpos[2, 7:] = 0.335, torch.tensor([0.0, 0.0, -2.5, 0.0, 0.0, 2.5] * 2)
        engine.reset(torch.arange(3), qpos, qvel)
        engine.step(qpos[:, 7:].float())
        readings = engine.read()
        assert (readings.crash_contacts > 0).tolist() == [False, True, False]
        assert readings.foot_contacts[0].bool().all()
        assert not readings.foot_contacts[1].any()
        assert not readings.foot_contacts[2].any()
        assert readings.collision_contacts.tolist() == [0.0, 0.0, 4.0]

    @pytest.mark.parametrize("collide", [True, False])
    def test_legs_meet_each_other_in_the_air(self, collide):
        """The front legs swing back and the hind ones forward until shanks cross; N_c counts what touches."""
        tile = build_tile(FAMILIES["flat"], 0.0, np.random.default_rng(0), "training")
        model = compile_world(ROBOT, tile, PhysicsConfig(leg_contacts=collide))
        engine = CpuPhysics(ROBOT, [model], PhysicsConfig(), 1, threads=1)
        qpos, qvel = standing(1, 3.0)
        engine.reset(torch.arange(1), qpos, qvel)
        targets = torch.tensor([[0.0, 1.3, -0.4, 0.0, -1.3, 0.4] * 2])
        counts = 0.0
        for _ in range(25):
            engine.step(targets)
            counts += float(engine.read().collision_contacts)
        assert (counts > 0) == collide
        assert not engine.read().crash_contacts.any()

    def test_a_leg_does_not_collide_with_itself_or_the_base(self):
        """Collision bits over all geoms: each leg meets the others and the terrain, the base the terrain alone."""
        model = world()
        leg_of_body = [model.body(body).name[:2] for body in range(model.nbody)]
        own = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom]]
        for first in own:
            for second in own:
                meet = (model.geom_contype[first] & model.geom_conaffinity[second]) != 0
                legs = [leg_of_body[model.geom_bodyid[geom]] for geom in (first, second)]
                assert meet == (legs[0] != legs[1] and "ba" not in legs)
        assert all(model.geom_contype[geom] & model.geom_conaffinity[0] for geom in own)

    def test_foot_velocity_is_measured_in_the_world(self):
        """A robot in free fall that moves to the left: the feet move to the left and, after 3 steps of 4, fall."""
        engine = an_engine(1)
        qpos, qvel = standing(1, 5.0)
        qpos[0, 3:7] = torch.tensor([0.5**0.5, 0.0, 0.0, 0.5**0.5])
        qvel[0, 1] = 1.5
        engine.reset(torch.arange(1), qpos, qvel)
        engine.step(DEFAULT[None])
        # Sensors are one physics step older than the velocities.
        expected = torch.tensor([0.0, 1.5, -9.81 * 0.015]).expand(4, 3)
        torch.testing.assert_close(engine.read().foot_vel_w[0], expected, atol=0.01, rtol=0.0)
        torch.testing.assert_close(engine.read().base_lin_vel_w[0, 2], torch.tensor(-9.81 * 0.02), atol=0.01, rtol=0.0)

    def test_a_push_adds_velocity_to_the_base(self):
        engine = an_engine(3)
        engine.push(torch.tensor([1]), torch.tensor([[0.5, -0.25, 0.0]], dtype=torch.double))
        expected = torch.tensor([[0.0, 0.0, 0.0], [0.5, -0.25, 0.0], [0.0, 0.0, 0.0]])
        assert torch.equal(engine.read().base_lin_vel_w, expected)
        assert not engine.read().joint_vel.any()


MIXED = ("flat", "rough", "stairs", "pit", "gap", "obstacles", "steps", "slope_down")


def test_any_number_of_threads_gives_the_same_bits():
    one, two = an_engine(24, MIXED, threads=1), an_engine(24, MIXED, threads=2)
    for engine in (one, two):
        rng = np.random.default_rng(0)
        for step in range(60):
            disturb(engine, step, rng, len(MIXED))
    assert_same(one, two)
    assert one.read().foot_contacts.any()


def test_a_saved_engine_goes_on_with_the_same_bits():
    engine, other = an_engine(16, MIXED), an_engine(16, MIXED)
    rng = np.random.default_rng(0)
    for step in range(25):
        disturb(engine, step, rng, len(MIXED))
    for step in range(5):
        disturb(other, step, np.random.default_rng(9), len(MIXED))
    saved = {name: value.clone() for name, value in engine.state_dict().items()}
    kept_rng = np.random.default_rng(0)
    kept_rng.bit_generator.state = rng.bit_generator.state
    for step in range(25, 50):
        disturb(engine, step, rng, len(MIXED))
    other.load_state_dict(saved)
    for step in range(25, 50):
        disturb(other, step, kept_rng, len(MIXED))
    assert_same(engine, other)


def break_qvel(engine: CpuPhysics, env_id: int) -> None:
    engine.push(torch.tensor([env_id]), torch.full((1, 3), torch.nan, dtype=torch.double))


def break_qpos(engine: CpuPhysics, env_id: int) -> None:
    qpos, qvel = standing(1, torch.nan)
    engine.reset(torch.tensor([env_id]), qpos, qvel)


def explode(engine: CpuPhysics, env_id: int) -> None:
    engine.push(torch.tensor([env_id]), torch.tensor([[0.0, 0.0, 1e12]], dtype=torch.double))


FAULTS = (break_qvel, break_qpos, explode)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_robot_that_diverges_is_reported_and_harms_no_other(fault, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    healthy, faulty = an_engine(8, MIXED, threads=2), an_engine(8, MIXED, threads=2)
    others = [0, 1, 2, 4, 5, 6, 7]
    for engine in (healthy, faulty):
        rng = np.random.default_rng(0)
        for step in range(10):
            if step == 5 and engine is faulty:
                fault(engine, 3)
            engine.step(DEFAULT + torch.from_numpy(rng.normal(0, 0.5, (8, 12))).float())
            expected = [not (engine is faulty and step >= 5 and i == 3) for i in range(8)]
            assert engine.read().finite.tolist() == expected
    assert_same(healthy, faulty, others)

    for engine in (healthy, faulty):
        engine.reset(torch.tensor([3]), *standing(1, ROBOT.standing_height))
        engine.step(DEFAULT.expand(8, 12))
    assert faulty.read().finite.all()
    assert_same(healthy, faulty)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def an_env() -> ArriveEnv:
    """Six robots in full-length episodes with no chance in their future."""
    config = Config(
        num_envs=6,
        terrain=TerrainConfig(families=("flat", "rough", "stairs"), levels=2, variants=1),
        observation=ObservationConfig(noise=False),
        randomisation=RandomisationConfig(push_speed=0.0),
        task=FinalConfig(
            rewards=replace(
                PAPER_REWARDS, approach=Approach(1.0), stand=Reward(1.0), pose_cost=Cost(-1.0), crash_cost=Cost(-2.0)
            )
        ),
    )
    everyone = torch.arange(6)
    return build_env(config, Placement(assignment=(everyone % 3, torch.zeros(6, dtype=torch.long))), threads=1)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_environment_resets_a_robot_that_diverges_and_goes_on(fault, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    healthy, faulty = an_env(), an_env()
    others = [0, 1, 3, 4, 5]
    for step in range(15):
        if step == 5:
            fault(faulty.physics, 2)
        generator = torch.Generator().manual_seed(step)
        actions = 0.3 * torch.randn(6, 12, generator=generator)
        (seen, earned, ended, _), (expected, expected_reward, _, _) = (e.step(actions) for e in (faulty, healthy))
        assert ended.tolist() == [0, 0, int(step == 5), 0, 0, 0]
        assert faulty.log.diverged == int(step == 5)
        assert seen[POLICY].isfinite().all()
        assert earned.isfinite().all()
        assert torch.equal(seen[POLICY][others], expected[POLICY][others])
        assert torch.equal(earned[others], expected_reward[others])
        if step == 5:
            assert float(earned[2]) == 0.0
            assert faulty.log.finished.env_ids.tolist() == [2]
            assert faulty.log.finished.counted.tolist() == faulty.log.finished.success.tolist() == [False]
            assert faulty.episode_length_buf.tolist() == [6, 6, 0, 6, 6, 6]
            assert all(value.isfinite().all() for value in vars(faulty.log.finished).values() if torch.is_tensor(value))
    assert faulty.exploration.state_dict()["sums"].isfinite().all()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_simulation_that_mujoco_gives_up_counts_as_diverged(monkeypatch):
    """MuJoCo leaves it in a finite state, which would otherwise stand still for ever."""
    engine = an_engine(4)

    class Failing:
        def __getattr__(self, name):
            return getattr(batch, name)

        def step(self, ids=None, nstep=1):
            raise SimulationError(np.array([2]), "out of memory")

    batch = engine._batch
    monkeypatch.setattr(engine, "_batch", Failing())
    engine.step(torch.zeros(4, 12))
    assert engine.read().finite.tolist() == [True, True, False, True]


def test_payload_scales_mass_and_inertia_however_the_robot_gives_them():
    """A matrix, principal axes, or nothing but geoms with masses: a payload of as much again doubles both."""

    def with_base(describe: str) -> Robot:
        def build(visuals: bool) -> mujoco.MjSpec:
            spec = ROBOT.build_spec(visuals)
            base = spec.body("base")
            if describe != "a matrix":
                base.fullinertia = [np.nan, 0, 0, 0, 0, 0]
            if describe == "principal axes":
                base.inertia, base.iquat = [0.2, 1.8, 1.9], [0.8, 0, 0.6, 0]
            elif describe == "geoms":
                base.explicitinertial, base.ipos = False, [np.nan, 0, 0]
                for geom in base.geoms:
                    geom.mass = 9.0
            return spec

        return replace(ROBOT, build_spec=build)

    tile = build_tile(FAMILIES["flat"], 0.0, np.random.default_rng(0), "training")
    for describe in ("a matrix", "principal axes", "geoms"):
        robot = with_base(describe)
        plain = compile_world(robot, tile, PhysicsConfig()).body("base")
        loaded = compile_world(robot, tile, PhysicsConfig(), payload_kg=float(plain.mass[0])).body("base")
        assert loaded.mass == pytest.approx(2.0 * plain.mass), describe
        np.testing.assert_allclose(loaded.inertia, 2.0 * plain.inertia, rtol=1e-9, err_msg=describe)
        np.testing.assert_allclose(loaded.ipos, plain.ipos, atol=1e-12, err_msg=describe)
        with pytest.raises(ArriveError, match=r"leaves nothing of the .* kg of anymal_c's base.*payload_kg"):
            compile_world(robot, tile, PhysicsConfig(), payload_kg=-float(plain.mass[0]))


def test_long_steps_are_those_of_a_world_compiled_with_them():
    """And back again, bit for bit."""
    tile = build_tile(FAMILIES["rough"], 0.1, np.random.default_rng(0), "training")
    standard, long = PhysicsConfig(), with_decimation(PhysicsConfig(), 2)
    assert (long.timestep_s, long.contact_time_s, long.control_dt) == (0.01, 0.02, standard.control_dt)
    changed = CpuPhysics(ROBOT, [compile_world(ROBOT, tile, standard)], standard, 4)
    for config in (long, standard):
        changed.set_decimation(config.decimation)
        compiled = CpuPhysics(ROBOT, [compile_world(ROBOT, tile, config)], config, 4)
        rng = np.random.default_rng(0)
        for engine in (changed, compiled):
            engine.reset(torch.arange(4), *standing(4, ROBOT.standing_height))
        for _ in range(15):
            targets = DEFAULT + torch.from_numpy(rng.normal(0, 0.4, (4, 12))).float()
            for engine in (changed, compiled):
                engine.step(targets)
        assert_same(changed, compiled)
        assert changed.read().foot_contacts.any()
        assert changed.state_dict()["time"].tolist() == pytest.approx(4 * [0.3])


def test_time_constants_that_mujoco_would_raise_silently_are_refused():
    with pytest.raises(ArriveError, match=r"contact_time_s must be at least 2 physics steps, 0.02 s, .* not 0.01"):
        check_fields(PhysicsConfig(timestep_s=0.01))
    check_fields(PhysicsConfig(timestep_s=0.01, contact_time_s=0.02))
    tile = build_tile(FAMILIES["flat"], 0.0, np.random.default_rng(0), "training")
    with pytest.raises(ArriveError, match="contact_time_s"):
        compile_world(ROBOT, tile, PhysicsConfig(timestep_s=0.01))
    with pytest.raises(ArriveError, match=r"limit of joint LF_HAA has a time constant of 0.02 s.*timestep_s to 0.01"):
        compile_world(ROBOT, tile, PhysicsConfig(timestep_s=0.02, contact_time_s=0.04))
