"""Energy per metre at commanded speeds (paper, section Energy Consumption, figure 4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from arrive.build import OnProgress
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.difficulty import origin_of
from arrive.evaluation.estimate import mean, ratio
from arrive.evaluation.motors import MeteredPhysics, meter
from arrive.evaluation.playing import Pilot
from arrive.evaluation.walking import LEAD_S, Heading, check_speeds, conditions, possible, walking_env
from arrive.learning.policy import Policy
from arrive.learning.rundir import commit
from arrive.terms import LEAD_M

NAME = "energy"
"""The protocol of this measurement."""
GRAVITY = 9.81
"""[m/s^2]."""
STALL_S = 10.0
"""A robot that walks less than `STALL_M` in this time stands [s]."""
STALL_M = 0.5
"""[m]."""
LEAST_M = 2.0
"""Robots that fell before this say nothing about walking; they are counted [m]."""
SLOWEST = STALL_M / STALL_S
"""Slowest robot that can finish [m/s]."""
FIGURES = {
    "torque_sq": "sum of squared torques per metre [N^2 m^2 s/m]",
    "positive_work": "positive mechanical work per metre [J/m]",
    "absolute_work": "absolute mechanical work per metre [J/m]",
    "cost_of_transport": "positive mechanical work over m g times the way",
    "speed": "speed reached [m/s]",
    "time_s": "time for the whole way [s]",
}
"""The measurements at each speed, each a value with the ends of its 95 % interval."""


@dataclass
class Walks:
    """Distance and energy of every robot; each (n,), on the CPU."""

    way_m: Tensor
    """Along the direction in which it was sent [m]."""
    time_s: Tensor
    finished: Tensor
    """bool."""
    fell: Tensor
    """bool; who neither finished nor fell stood still."""
    torque_sq: Tensor
    """[N^2 m^2 s]."""
    positive_work: Tensor
    """[J]."""
    absolute_work: Tensor
    """[J]."""
    weight: Tensor
    """[N]."""


def measure_energy(
    policy: Policy,
    speeds: Sequence[float],
    robots: int,
    way_m: float,
    seed: int,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
) -> dict[str, Any]:
    """Let robots walk a way at each speed and sum up what their motors spend.

    Args:
        robots: per speed.
        way_m: how far each walks [m].
        progress: called with the metres that all robots walked so far and their total.

    Returns:
        JSON data: which policy, and a row per speed that it was really commanded, see `possible`.

    Raises:
        ArriveError: nothing to measure, or a policy whose task takes no constant command.
    """
    check_energy_arguments(speeds, robots, way_m)
    commands = possible(policy, [Heading(speed) for speed in speeds])
    env = walking_env(policy, commands, robots, way_m / SLOWEST, seed, threads)
    walks = walk(env, policy, meter(env, threads), way_m, progress)
    parts = torch.arange(len(commands)).repeat_interleave(robots)
    rows = [row(heading.speed, walks, parts == i, way_m) for i, heading in enumerate(commands)]
    return origin_of(policy) | conditions(policy) | {"speeds": rows}


def check_energy_arguments(speeds: Sequence[float], robots: int, way_m: float) -> None:
    """Refuse arguments with which there is nothing to measure.

    Raises:
        ArriveError: no speeds, fewer than two robots, or a way that is too short or leads off the ground.
    """
    check_speeds(tuple(speeds))
    if not 2 <= robots <= 10_000:
        raise ArriveError(f"--robots must be 2 to 10000, for the intervals come from their spread, not {robots}")
    if not LEAST_M <= way_m <= 200.0:
        raise ArriveError(f"--distance must be {LEAST_M:g} to 200 m, not {way_m:g}")


def walk(env: ArriveEnv, pilot: Pilot, motors: MeteredPhysics, way_m: float, progress: OnProgress) -> Walks:
    """Let every robot walk until it has covered the way, fallen or stopped."""
    n, start_x = env.num_envs, env.state.base_pos_w[:, 0].clone()
    way, mark = (torch.zeros(n, device=env.device) for _ in range(2))
    time_s, weight = torch.zeros(n), _weights(env)
    finished, fell, waiting = (torch.zeros(n, dtype=torch.bool, device=env.device) for _ in range(3))
    waiting[:] = True
    observation = env.get_observations()[POLICY]
    stall_steps = round(STALL_S / env.control_dt)
    for step in range(1, env.max_episode_length + 1):
        observation = env.step(pilot.act(observation))[0][POLICY]
        down = torch.zeros_like(waiting)
        if env.log.finished is not None:
            down[env.log.finished.env_ids] = True
        now = env.state.base_pos_w[:, 0] - start_x
        # Who fell has been put back to the start by now.
        way = torch.where(waiting & ~down, now, way)
        done = waiting & ~down & (way >= way_m)
        stood = torch.zeros_like(waiting)
        if step % stall_steps == 0:
            stood, mark = waiting & (way - mark < STALL_M), way.clone()
        ended = waiting & (done | down | stood)
        fell |= waiting & down
        finished |= done
        if bool(ended.any()):
            time_s[ended.cpu()] = step * env.control_dt
            waiting &= ~ended
            env.deactivate(ended.nonzero().squeeze(-1))
        progress(int(torch.where(waiting, way.clamp(0.0, way_m), way_m).sum()), round(n * way_m))
        if not bool(waiting.any()):
            break
    return Walks(
        way_m=way.cpu(),
        time_s=time_s,
        finished=finished.cpu(),
        fell=fell.cpu(),
        torque_sq=motors.torque_sq.cpu(),
        positive_work=motors.positive_work.cpu(),
        absolute_work=motors.absolute_work.cpu(),
        weight=weight,
    )


def _weights(env: ArriveEnv) -> Tensor:
    """(num_envs,) m g of each robot with its payload [N]."""
    masses = [float(env.physics.model_of_env(i).body_mass.sum()) for i in range(env.num_envs)]
    return GRAVITY * torch.tensor(masses)


def row(speed: float, walks: Walks, mine: Tensor, way_m: float) -> dict[str, Any]:
    """One speed's figures as JSON data; None where fewer than two robots walked.

    Args:
        mine: (n,) bool, the robots with this commanded speed.
    """
    fell = mine & walks.fell
    walked = mine & ((walks.fell & (walks.way_m >= LEAST_M)) | walks.finished)
    finished = mine & walks.finished
    way = walks.way_m[walked]
    figures = {
        "torque_sq": ratio(walks.torque_sq[walked], way),
        "positive_work": ratio(walks.positive_work[walked], way),
        "absolute_work": ratio(walks.absolute_work[walked], way),
        "cost_of_transport": ratio(walks.positive_work[walked], walks.weight[walked] * way),
        "speed": ratio(way, walks.time_s[walked]),
        "time_s": mean(walks.time_s[finished]),
    }
    return {
        "told_m_s": speed,
        "robots": int(mine.sum()),
        "finished": int(finished.sum()),
        "fell": int(fell.sum()),
        "stood": int((mine & ~walks.finished & ~walks.fell).sum()),
        "metres": round(float(way.sum()), 3),
    } | {name: None if figure is None else [round(value, 6) for value in figure] for name, figure in figures.items()}


def energy_content(policies: list[dict[str, Any]], robots: int, way_m: float, seed: int) -> dict[str, Any]:
    """The whole measurement as JSON data."""
    return {
        "policies": policies,
        "figures": FIGURES,
        "protocol": {
            "name": NAME,
            "robots": robots,
            "way_m": way_m,
            "effort": sum(len(policy["speeds"]) for policy in policies) * robots * way_m,
            "seed": seed,
            "terrain": "flat",
            "observation_noise": True,
            "command": {
                "velocity": "its speed",
                "final": f"a target that stays {LEAD_M:g} m ahead and a time left that stays {LEAD_M:g} m / speed",
                "continuous": (
                    f"a target that stays speed * {LEAD_S:g} s ahead and a time left that stays half an episode"
                ),
            },
            "counted": f"the robots that finished, and those that fell after {LEAST_M:g} m or more",
            "stood": f"walked less than {STALL_M:g} m in {STALL_S:g} s",
        },
        "commit": commit(),
    }
