"""Small results of every format, and their damages: each key removed, or with a value of another type or size."""

import copy
import math
import random
from collections.abc import Callable, Iterator
from typing import Any

from arrive.errors import ArriveError

Place = tuple[str | int, ...]
REMOVED = object()
WRONG = (REMOVED, None, "text", "1", "", True, -1, 0, 1.5, math.nan, math.inf, 10**400, 1e300, [], {}, [[1]], {"a": 1})
"""What a damaged file has in a place."""


def difficulty(name: str = "run") -> dict[str, Any]:
    """Of a policy that passes a gap of 0.3 m in 95 %."""
    usage = {
        "value": 0.3,
        "episodes": 19,
        "arrival_time_s": [3.0, 4.0, 5.0],
        "path_length_m": [5.0, 5.1, 5.4],
        "speed_profile": {"time_s": [0.1, 0.3], "mean_m_s": [0.5, 0.6]},
        "motion": {"torque_nm": 20.0},
    }
    levels = [
        {"value": 0.3, "episodes": 20, "success": 0.95, "interval": [0.7, 0.99], "failures": {"crash": 1}},
        {"value": 0.6, "episodes": 20, "success": 0.0, "interval": [0.0, 0.2], "failures": {"fell": 20}},
    ]
    limits = {"max_at_95": 0.3, "max_at_80": 0.3, "max_at_50": 0.3}
    start = {"start_yaw_rad": 0.2, "start_offset": 0.1, "start_speed": 0.1, "start_joint_scale": 0.1}
    return {
        "families": {"gap": {"parameter": "width", "unit": "m", "levels": levels} | limits},
        "policy": {"name": name, "samples": 10_000_000, "usage": {"gap": [usage, {"value": 0.6, "episodes": 0}]}},
        "protocol": {
            "name": "difficulty",
            "episodes": 20,
            "seed": 1,
            "levels": 2,
            "terrain_m": 4.0,
            "trial": {"duration_s": 8.0, "target": [5.0, 0.0], "speed": 1.0, "walk": 4.0},
            "arrival_radius_m": 0.5,
            "worlds_per_level": 50,
            "randomisation": start | {"friction": [0.75, 1.1], "payload_kg": [-5.0, 5.0]},
            "observation_noise": True,
            "success": "at the target; without a crash",
            "note": "robots have 8 s",
        },
        "commit": "abcdef123456",
    }


def reach() -> dict[str, Any]:
    """Of the same policy."""
    row = {"episodes": 9, "success": 1.0, "interval": [0.7, 1.0], "failures": {"late": 0}}
    return {
        "families": {
            "gap": {
                "value": 0.3,
                "distances": [
                    row | {"distance_m": distance, "time_s": time, "direction_deg": 0.0, "stood_at_m": 1.5}
                    for distance in (1.0, 3.0)
                    for time in (4.0, 8.0)
                ],
                "directions": [row | {"direction_deg": angle, "distance_m": None} for angle in (0.0, 90.0)],
                "waiting": {
                    "wait_s": 30.0,
                    "time_s": 8.0,
                    "arrived": 9,
                    "stayed": 8,
                    "share": 8 / 9,
                    "interval": [0.5, 0.98],
                    "failures": {"crash": 1},
                },
            }
        },
        "protocol": {
            "name": "reach",
            "episodes": 9,
            "seed": 1,
            "layout": "evaluation",
            "distances_m": [1.0, 3.0],
            "directions_deg": [0.0, 90.0],
            "times_s": [4.0, 8.0],
            "success": "at the target",
            "by_distance": "straight ahead",
            "by_direction": "all distances",
        },
        "commit": "abcdef123456",
    }


def origin(name: str, task: str) -> dict[str, Any]:
    """Where a policy is from that was measured beside others."""
    return {"name": name, "task": task, "seed": 7, "samples": 20_000_000, "commit": "abcdef123456789"}


def walked(speed: float, torque_sq: float, half: float = 1.0) -> dict[str, Any]:
    """A row of energy.json."""
    figures = {name: [1.0, 0.9, 1.1] for name in ("positive_work", "absolute_work", "cost_of_transport", "time_s")}
    return figures | {
        "told_m_s": speed,
        "robots": 50,
        "finished": 50,
        "fell": 0,
        "stood": 0,
        "torque_sq": [torque_sq, torque_sq - half, torque_sq + half],
        "speed": [speed, speed - 0.01, speed + 0.01],
    }


def energy() -> dict[str, Any]:
    """Of two policies; at the second speed nobody walked."""
    nobody = dict.fromkeys(("torque_sq", "positive_work", "absolute_work", "cost_of_transport", "speed", "time_s"))
    speeds = [walked(0.5, 60.0), walked(1.0, 50.0) | nobody | {"fell": 50}]
    return {
        "policies": [origin("run", "final") | {"speeds": speeds}, origin("other", "velocity") | {"speeds": speeds}],
        "protocol": {
            "name": "energy",
            "robots": 50,
            "way_m": 100.0,
            "seed": 3,
            "command": {"velocity": "its speed", "final": "a target ahead", "continuous": "a target far ahead"},
            "counted": "all metres",
        },
        "commit": "abcdef123456",
    }


def gait() -> dict[str, Any]:
    """Of a policy that trots forward and does not walk sideways."""
    trot = {
        "gait": "trot",
        "duty": [[0.5, 0.4, 0.6]] * 2,
        "phase": [0.0, 0.5],
        "speed_m_s": [1.0, 0.9, 1.1],
        "stride_frequency_hz": [2.0, 1.9, 2.1],
        "stride_length_m": [0.5, 0.4, 0.6],
        "travel_deg": 1.0,
        "hildebrand": {"hind_duty": 0.5, "fore_after_hind": 0.5},
        "diagram": {"dt_s": 0.02, "stands": [[1, 0, 1], [0, 1, 0]]},
    }
    rows = [
        {"told_m_s": 1.0, "direction_deg": 0.0, "fell": 0} | trot,
        {"told_m_s": 1.0, "direction_deg": 90.0, "fell": 50, "gait": None},
    ]
    return {
        "policies": [origin("run", "final") | {"feet": ["LF", "RH"], "gaits": rows}],
        "protocol": {"name": "gait", "robots": 50, "seconds": 10.0, "settle_s": 5.0, "seed": 1, "together": 0.1},
        "commit": "abcdef123456",
    }


def stability() -> dict[str, Any]:
    """Of two of three variants."""

    def run(variant: str, seed: int, success: float) -> dict[str, Any]:
        return {
            "ground": "flat",
            "variant": variant,
            "seed": seed,
            "success": success,
            "explained_variance": 0.5,
            "value_loss": 0.1,
            "curve": {"samples": [0.0, 1e6], "explained_variance": [0.1, 0.5]},
        }

    return {
        "runs": [run("ours", 1, 0.95), run("ours", 2, 0.9), run("short", 1, 0.89), run("short", 2, 1.0)],
        "variants": {"ours": "12 steps", "short": "half the steps", "long": "20 s"},
        "protocol": {
            "name": "stability",
            "preset": "robust",
            "samples": 5e6,
            "goal": 0.9,
            "grounds": ["flat"],
            "seeds": [1, 2],
            "episodes": 100,
        },
        "command": "python benchmarks/stability.py --samples 5M",
        "commit": "abc",
    }


def window() -> dict[str, Any]:
    """Of a window with which half arrive, and one with which nobody does."""
    run = {
        "window_s": 0.5,
        "seed": 1,
        "success": 0.5,
        "interval": [0.4, 0.6],
        "arrival_time_s": [5.0, 6.0, 7.0],
        "path_length_m": [4.0, 5.0, 6.0],
        "speed_profile": {"time_s": [0.1, 0.3], "mean_m_s": [0.5, 0.6]},
        "energy": [walked(0.5, 60.0)],
    }
    none = dict.fromkeys(("arrival_time_s", "path_length_m", "speed_profile"))
    nobody = run | none | {"window_s": 8.0, "success": 0.0, "interval": [0.0, 0.04], "energy": []}
    return {
        "runs": [run, nobody],
        "protocol": {
            "name": "time_window",
            "preset": "robust",
            "ground": "gap=0.3",
            "samples": 1e7,
            "episodes": 100,
            "episode_s": 8.0,
            "seeds": [1],
        },
        "command": "python benchmarks/time_window.py",
        "commit": "abc",
    }


RESULTS = {
    "difficulty": difficulty,
    "reach": reach,
    "energy": energy,
    "gait": gait,
    "stability": stability,
    "time_window": window,
}
"""A small result of every format."""


def places(content: Any, place: Place = ()) -> Iterator[Place]:
    """Every key and every list entry, the outer ones first."""
    entries = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in entries:
        yield (*place, key)
        yield from places(value, (*place, key))


def damaged(content: dict[str, Any], place: Place, wrong: Any) -> dict[str, Any]:
    """The content with another value in one place, or without it."""
    content = copy.deepcopy(content)
    part: Any = content
    for key in place[:-1]:
        part = part[key]
    if wrong is REMOVED:
        del part[place[-1]]
    else:
        part[place[-1]] = wrong
    return content


def damages(content: dict[str, Any], count: int | None = None, seed: int = 0) -> Iterator[tuple[Place, Any, dict]]:
    """Place, wrong value and damaged content: all that there are, or so many of them drawn from a seed."""
    cases = [(place, wrong) for place in places(content) for wrong in WRONG]
    for place, wrong in cases if count is None else random.Random(seed).sample(cases, min(count, len(cases))):
        yield place, wrong, damaged(content, place, wrong)


def refusal(call: Callable[[], object]) -> str | None:
    """The message with which a call refuses, or None."""
    try:
        call()
    except ArriveError as error:
        return str(error)
    return None


def marked(content: Any, mark: str) -> Any:
    """The content with a mark after every text, but not in keys and in the name of its format."""
    if isinstance(content, dict):
        kept = {"name": content["name"]} if content.get("name") in RESULTS else {}
        return {key: marked(value, mark) for key, value in content.items()} | kept
    if isinstance(content, list):
        return [marked(value, mark) for value in content]
    return content + mark if isinstance(content, str) else content
