"""Scales a configuration to a robot of another size than ANYmal C.

Presets have values for ANYmal C. For another size they are scaled by dynamic similarity (Froude): with lengths scaled
by s, speeds and step times scale with the square root of s, angular accelerations with 1/s, torques with mass times s.
Values of the task (distances, episode lengths, arrival radius) are not scaled.
"""

from dataclasses import replace
from typing import TypeVar

from arrive.config import Config, fewest_steps
from arrive.fields import Interval
from arrive.robots.robot import Robot
from arrive.task.final import PositionConfig
from arrive.task.heights import FootHeightsConfig, HeightsConfig
from arrive.task.rewards import Cost

Grid = TypeVar("Grid", HeightsConfig, FootHeightsConfig)
WIDEST_DEFAULT_RAD = 0.8
"""Largest joint angle of ANYmal C's default pose [rad]."""
DIGITS = 4
"""Significant digits of scaled values, to keep them readable."""


def for_robot(config: Config, robot: Robot) -> Config:
    """The configuration for this robot, with values scaled to its size and mass. For ANYmal C nothing changes."""
    size, mass = robot.size, robot.mass_share
    observation, random, task = config.observation, config.randomisation, config.task
    heights, rewards = observation.heights, task.rewards
    weight_factors = {"torque_cost": (mass * size) ** -2, "joint_acc_cost": size**2}
    terms = {name: Cost(_scaled(getattr(rewards, name).weight, factor)) for name, factor in weight_factors.items()}
    if hasattr(rewards, "stall_cost"):
        terms["stall_cost"] = replace(rewards.stall_cost, speed=_scaled(rewards.stall_cost.speed, size**0.5))
    if hasattr(rewards, "air_time"):
        terms["air_time"] = replace(rewards.air_time, least_s=_scaled(rewards.air_time.least_s, size**0.5))
    task = replace(task, rewards=replace(rewards, **terms))
    if isinstance(task, PositionConfig):
        task = replace(task, target_height=_scaled(task.target_height, size))
    return replace(
        config,
        robot=robot.name,
        observation=replace(
            observation,
            foot_heights=_resized(observation.foot_heights, size),
            heights=replace(
                _resized(heights, size),
                noise=_scaled(heights.noise, size),
                scale=_scaled(heights.scale, 1.0 / size),
                clip=_scaled_pair(heights.clip, size),
            ),
        ),
        randomisation=replace(
            random,
            payload_kg=_scaled_pair(random.payload_kg, mass),
            push_speed=_scaled(random.push_speed, size**0.5),
            start_offset=_scaled(random.start_offset, size),
            start_joint_scale=_scaled(random.start_joint_scale, _start_share(robot)),
        ),
        task=task,
        schedule=replace(config.schedule, decimation=_steps(config, robot)),
    )


def _steps(config: Config, robot: Robot) -> int:
    """The schedule's physics steps per policy step, and more if the robot's joint limits need shorter ones."""
    wanted = config.schedule.decimation
    return max(wanted, fewest_steps(robot, config.physics.control_dt)) if wanted else 0


def _resized(grid: Grid, size: float) -> Grid:
    """With the extents and the step of a larger or smaller robot."""
    length, width, step = (_scaled(extent, size) for extent in (grid.length, grid.width, grid.step))
    return replace(grid, length=length, width=width, step=step)


def _scaled_pair(pair: Interval, factor: float) -> Interval:
    return _scaled(pair[0], factor), _scaled(pair[1], factor)


def _start_share(robot: Robot) -> float:
    """Factor on the start's share of the default pose, 1 or less, that gives more bent legs ANYmal C's angle.

    Half of a calf at -1.5 rad would take it beyond its range and the foot into the ground.
    """
    widest = max(abs(position) for position in robot.default_joint_pos)
    return min(1.0, WIDEST_DEFAULT_RAD / widest) if widest else 1.0


def _scaled(value: float, factor: float) -> float:
    """The product, rounded. If the factor is 1, the value itself."""
    return value if factor == 1.0 else float(f"{value * factor:.{DIGITS}g}")
