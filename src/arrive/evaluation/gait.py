"""How policies step: footfalls of steady walking at chosen speeds and directions (paper, section Emergent Gaits)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from arrive.build import OnProgress
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.difficulty import origin_of
from arrive.evaluation.estimate import mean
from arrive.evaluation.footfalls import NAMES, TOGETHER, Footfalls, circular, footfalls, gait_name, hildebrand, steady
from arrive.evaluation.playing import Pilot
from arrive.evaluation.walking import Heading, check_speeds, conditions, possible, walking_env
from arrive.learning.policy import Policy
from arrive.learning.rundir import commit
from arrive.robots.robot import Robot
from arrive.task.rotation import yaw_of

NAME = "gait"
"""The protocol of this measurement."""
SETTLE_S = 5.0
"""Robots walk this long before they are looked at [s]."""
WALKING_M_S = 0.1
"""Who is slower on average stands [m/s]."""
SHOWN_S = 2.0
"""Length of the footfall diagram [s]."""


@dataclass(frozen=True, eq=False)
class GaitRecording:
    """Steady walking of n robots, as NumPy arrays."""

    contact: np.ndarray
    """(steps, n, feet) bool."""
    velocity: np.ndarray
    """(steps, n, 2) horizontal velocity of the base in the world [m/s]."""
    yaw: np.ndarray
    """(steps, n) [rad]."""
    height: np.ndarray
    """(steps, n) of the base [m]."""
    upright: np.ndarray
    """(n,) bool: did not fall."""


def measure_gait(
    policy: Policy,
    commands: Sequence[Heading],
    robots: int,
    seconds: float,
    seed: int,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
) -> dict[str, Any]:
    """Let robots walk steadily and describe their gait at each speed and direction.

    Args:
        robots: per speed and direction.
        seconds: how long they are looked at [s].
        progress: called with the policy steps done so far and their total.

    Returns:
        JSON data: which policy, its feet, and a row per speed and direction that it was really commanded, see
        `possible`.

    Raises:
        ArriveError: nothing to measure, or a policy whose task takes no such command.
    """
    check_gait_arguments(commands, robots, seconds)
    commands = possible(policy, commands)
    env = walking_env(policy, commands, robots, SETTLE_S + seconds, seed, threads)
    record = walk_steadily(env, policy, seconds, progress)
    corners = env.robot.foot_corners()
    rows = []
    for index, heading in enumerate(commands):
        mine = slice(index * robots, (index + 1) * robots)
        rows.append(_told(heading) | describe_gait(_part(record, mine), corners, env.control_dt))
    return (
        origin_of(policy)
        | conditions(policy)
        | {
            "feet": foot_labels(env.robot),
            "corners_m": np.round(corners, 3).tolist(),
            "gaits": rows,
        }
    )


def check_gait_arguments(commands: Sequence[Heading], robots: int, seconds: float) -> None:
    """Refuse arguments with which there is nothing to measure.

    Raises:
        ArriveError: no speeds or directions, fewer than two robots, or too short a look.
    """
    check_speeds(tuple(heading.speed for heading in commands))
    if not all(-360.0 <= heading.direction_deg <= 360.0 for heading in commands):
        raise ArriveError("--directions must be angles from -360 to 360 deg")
    if not 2 <= robots <= 10_000:
        raise ArriveError(f"--robots must be 2 to 10000, for the intervals come from their spread, not {robots}")
    if not SHOWN_S <= seconds <= 120.0:
        raise ArriveError(f"--seconds must be {SHOWN_S:g} to 120, not {seconds:g}")


def _told(heading: Heading) -> dict[str, float]:
    return {"told_m_s": heading.speed, "direction_deg": heading.direction_deg}


def walk_steadily(
    env: ArriveEnv, pilot: Pilot, seconds: float, progress: OnProgress = lambda i, n: None
) -> GaitRecording:
    """Let all robots walk for `SETTLE_S`, then record them."""
    settle, steps = (round(time / env.control_dt) for time in (SETTLE_S, seconds))
    upright = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    observation, rows = env.get_observations()[POLICY], []
    for step in range(settle + steps):
        observation = env.step(pilot.act(observation))[0][POLICY]
        if env.log.finished is not None:
            upright[env.log.finished.env_ids] = False
        if step >= settle:
            state = env.state
            row = (
                state.foot_contacts > 0,
                state.base_lin_vel_w[:, :2],
                yaw_of(state.base_quat_w),
                state.base_pos_w[:, 2],
            )
            rows.append([value.cpu().numpy().copy() for value in row])
        progress(step + 1, settle + steps)
    contact, velocity, yaw, height = (np.stack(column) for column in zip(*rows, strict=True))
    return GaitRecording(contact, velocity, yaw, height, upright.cpu().numpy())


def _part(record: GaitRecording, mine: slice) -> GaitRecording:
    return GaitRecording(
        record.contact[:, mine],
        record.velocity[:, mine],
        record.yaw[:, mine],
        record.height[:, mine],
        record.upright[mine],
    )


def describe_gait(record: GaitRecording, corners: np.ndarray, dt: float) -> dict[str, Any]:
    """The gait of robots that had the same command, as JSON data.

    Means are over the robots that walked and make whole strides; the name is the commonest of theirs. The reference
    foot is the one that stands longest.

    Args:
        corners: (feet, 2) as `Robot.foot_corners`.
        dt: time between rows of the record [s].
    """
    speed = np.linalg.norm(record.velocity.mean(0), axis=-1)
    walking = record.upright & (speed > WALKING_M_S)
    reference = int(record.contact[:, walking].mean((0, 1)).argmax()) if walking.any() else 0
    falls = {int(i): footfalls(record.contact[:, i], dt, reference) for i in np.flatnonzero(walking)}
    found = {i: fall for i, fall in falls.items() if fall is not None}
    content: dict[str, Any] = {
        "robots": len(speed),
        "fell": int((~record.upright).sum()),
        "stood": int((record.upright & ~walking).sum()),
        "stepped": len(found),
        "gait": None,
    }
    if len(found) < 2:
        return content
    names = {i: gait_name(fall, corners) for i, fall in found.items()}
    counts = Counter(names.values())
    name = counts.most_common(1)[0][0]
    chosen = _typical({i: fall for i, fall in found.items() if names[i] == name})
    return content | {
        "gait": name,
        "reference": reference,
        "names": dict(sorted(counts.items())),
        **_footfall_means(list(found.values()), corners),
        **_motion(record, list(found), [found[i].frequency_hz for i in found]),
        "diagram": {
            "dt_s": dt,
            "stands": steady(record.contact[:, chosen], dt)[: round(SHOWN_S / dt)].astype(int).T.tolist(),
        },
    }


def _typical(falls: dict[int, Footfalls]) -> int:
    """The robot whose phases are nearest to the circular mean of all."""
    phases = np.exp(2j * np.pi * np.array([fall.phase for fall in falls.values()]))
    return list(falls)[int(np.abs(phases - phases.mean(0)).sum(-1).argmin())]


def _footfall_means(falls: list[Footfalls], corners: np.ndarray) -> dict[str, Any]:
    """Means over robots, and how phases spread within a robot's strides and between robots."""
    phases = np.array([fall.phase for fall in falls])
    between = [circular(column) for column in phases.T]
    axes = [axis for fall in falls if (axis := hildebrand(fall, corners)) is not None]
    return {
        "duty": [_interval(column) for column in np.array([fall.duty for fall in falls]).T],
        "phase": [round(value, 4) for value, _ in between],
        "phase_spread_strides": [round(float(value), 4) for value in np.mean([fall.spread for fall in falls], axis=0)],
        "phase_spread_robots": [round(value, 4) for _, value in between],
        "hildebrand": None
        if not axes
        else {
            "hind_duty": round(float(np.mean([axis[0] for axis in axes])), 4),
            "fore_after_hind": round(circular(np.array([axis[1] for axis in axes]))[0], 4),
        },
    }


def _motion(record: GaitRecording, mine: list[int], frequencies: list[float]) -> dict[str, Any]:
    """Strides, direction of travel and motion of the base."""
    velocity, yaw = record.velocity[:, mine], record.yaw[:, mine]
    way = velocity.mean(0)
    speed = np.linalg.norm(way, axis=-1)
    along = (velocity * (way / speed[:, None])).sum(-1)
    # The direction in the robot's own frame, averaged over the time.
    course = np.arctan2(velocity[..., 1], velocity[..., 0]) - yaw
    means = [circular(column / (2 * np.pi))[0] for column in course.T]
    travel, spread = circular(np.array(means))
    return {
        "speed_m_s": _interval(speed),
        "stride_frequency_hz": _interval(np.array(frequencies)),
        "stride_length_m": _interval(speed / np.array(frequencies)),
        "travel_deg": round((360.0 * travel + 180.0) % 360.0 - 180.0, 2),
        "travel_spread_deg": round(360.0 * spread, 2),
        "speed_oscillation_m_s": _interval(along.std(0)),
        "height_oscillation_m": _interval(record.height[:, mine].std(0)),
    }


def _interval(values: np.ndarray) -> list[float]:
    """Mean over robots, two or more, and its 95 % interval."""
    interval = mean(torch.from_numpy(values.astype(float)))
    assert interval is not None
    return [round(value, 5) for value in interval]


def foot_labels(robot: Robot) -> list[str]:
    """Names of the feet without what all of them end in, such as LF for LF_FOOT."""
    sites = robot.foot_sites
    shared = 0
    while shared < min(map(len, sites)) - 1 and len({site[-shared - 1 :] for site in sites}) == 1:
        shared += 1
    return [(site[: len(site) - shared].rstrip("_-") or site) for site in sites]


def gait_content(policies: list[dict[str, Any]], robots: int, seconds: float, seed: int) -> dict[str, Any]:
    """The whole measurement as JSON data."""
    return {
        "policies": policies,
        "names": NAMES,
        "protocol": {
            "name": NAME,
            "robots": robots,
            "seconds": seconds,
            "settle_s": SETTLE_S,
            "seed": seed,
            "terrain": "flat",
            "observation_noise": True,
            "together": TOGETHER,
            "effort": sum(row["robots"] * seconds for policy in policies for row in policy["gaits"]),
        },
        "commit": commit(),
    }
