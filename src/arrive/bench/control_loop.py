"""A process that is nothing but the controller of a robot: `python -m arrive.bench.control_loop FILE STEPS`.

It imports NumPy and `arrive.deployment` alone, keeps to one core, and writes one line of JSON. Inputs are those of a
robot that trots in a circle over uneven ground, of which some cells were not seen, with a stick that turns: all of them
change in every step. Making them is not timed.
"""

import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from arrive.deployment import Controller, HeightMap, Joystick, Sensors

WARM_UP = 500
"""Steps before the first that is measured."""
MAP_CELLS, MAP_CELL_M = 100, 0.04
"""A robot-centric elevation map of 4 m x 4 m, as quadrupeds carry."""
UNSEEN = 0.02
"""Share of the map's cells that nothing was seen at."""
GAIT_HZ, SWING_RAD = 1.5, 0.3
"""Trot: frequency and amplitude of every joint."""
SPEED, TURN_RAD_S = 0.8, 0.3
"""Along the circle [m/s, rad/s]."""


class WalkInputs:
    """Inputs of the controller, as a function of time."""

    def __init__(self, controller: Controller):
        """Prepare the ground."""
        robot, rng = controller.policy.robot, np.random.default_rng(0)
        self._default = np.array(robot.default_joint_pos_rad)
        self._height = robot.standing_height_m
        self._phase = rng.uniform(0.0, 2.0 * math.pi, len(self._default))
        self._heights = rng.uniform(-0.05, 0.05, (MAP_CELLS, MAP_CELLS))
        self._heights[rng.random(self._heights.shape) < UNSEEN] = np.nan

    def at(self, time_s: float) -> tuple[Sensors, Joystick, HeightMap]:
        """Sensors, goal and heights at a time [s]."""
        angle = 2.0 * math.pi * GAIT_HZ * time_s + self._phase
        yaw, radius, sway = TURN_RAD_S * time_s, SPEED / TURN_RAD_S, 0.03 * math.sin(angle[0])
        position = np.array([radius * math.sin(yaw), -radius * math.cos(yaw), self._height + sway])
        quat = np.array([math.cos(yaw / 2), sway, sway, math.sin(yaw / 2)])
        sensors = Sensors(
            joint_pos=self._default + SWING_RAD * np.sin(angle),
            joint_vel=2.0 * math.pi * GAIT_HZ * SWING_RAD * np.cos(angle),
            base_pos_w=position,
            base_quat_w=quat / np.linalg.norm(quat),
            base_lin_vel_b=np.array([SPEED, sway, sway]),
            base_ang_vel_b=np.array([sway, sway, TURN_RAD_S]),
            time_s=time_s,
        )
        corner = position[:2] - MAP_CELLS * MAP_CELL_M / 2
        stick = Joystick(math.cos(0.5 * time_s), math.sin(0.5 * time_s), 0.0)
        return sensors, stick, HeightMap(corner, MAP_CELL_M, self._heights, time_s)


def resident_mb() -> float:
    """Resident memory of this process [MB = 10^6 bytes]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure_control_loop(path: str, steps: int) -> dict[str, Any]:
    """Time `steps` control steps of the policy in an exported file, one by one."""
    controller = Controller.load(path)
    walk, period = WalkInputs(controller), controller.policy.period_s
    latency_ns = np.zeros(steps, dtype=np.int64)
    refused = 0
    for i in range(-WARM_UP, steps):
        now_s = (i + WARM_UP) * period
        inputs = walk.at(now_s)
        start = time.perf_counter_ns()
        command = controller.step(*inputs, now_s)
        if i >= 0:
            latency_ns[i] = time.perf_counter_ns() - start
            refused += command.mode != "joystick"
    return {
        "latency_ms": {
            "median": float(np.median(latency_ns)) / 1e6,
            "p99": float(np.quantile(latency_ns, 0.99)) / 1e6,
            "max": float(latency_ns.max()) / 1e6,
        },
        "resident_mb": resident_mb() - latency_ns.nbytes / 1e6,
        "refused": refused,
        "foreign_modules": sorted({"torch", "mujoco", "onnx"} & set(sys.modules)),
    }


if __name__ == "__main__":
    # One core, as on a robot that has others for other things.
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(json.dumps(measure_control_loop(sys.argv[1], int(sys.argv[2]))))
