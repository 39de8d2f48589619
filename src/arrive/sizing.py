"""A configuration whose lengths, masses and weights are those of a robot of another size than ANYmal C.

Presets give figures for ANYmal C. A robot of another size has the same task in dynamically similar motion (Froude): at
lengths times s, speeds and the time of a step go with the root of s, angular accelerations with 1/s and torques with
mass times s. What is about the task and not the robot (distances, episodes, the arrival radius) stays.
"""

from dataclasses import replace

from arrive.config import Config
from arrive.robots.robot import Robot
from arrive.task.final import PositionConfig
from arrive.task.rewards import Cost

DIGITS = 4
"""Leading digits that fitted figures keep, for people to read."""


def for_robot(config: Config, robot: Robot) -> Config:
    """The configuration with this robot, its figures fitted to the robot's size and mass; for ANYmal C unchanged."""
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
            heights=replace(
                heights,
                noise=_scaled(heights.noise, size),
                scale=_scaled(heights.scale, 1.0 / size),
                clip=tuple(_scaled(height, size) for height in heights.clip),
                length=_scaled(heights.length, size),
                width=_scaled(heights.width, size),
                step=_scaled(heights.step, size),
            ),
        ),
        randomisation=replace(
            random,
            payload_kg=tuple(_scaled(payload, mass) for payload in random.payload_kg),
            push_speed=_scaled(random.push_speed, size**0.5),
            start_offset=_scaled(random.start_offset, size),
        ),
        task=task,
    )


def _scaled(value: float, factor: float) -> float:
    """The product, rounded; the value itself where the factor is 1."""
    return value if factor == 1.0 else float(f"{value * factor:.{DIGITS}g}")
