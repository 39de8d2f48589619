"""A configuration whose lengths, masses and weights are those of a robot of another size than ANYmal C.

Presets give figures for ANYmal C. A robot of another size has the same task in dynamically similar motion (Froude): at
lengths times s, speeds go with the root of s, angular accelerations with 1/s and torques with mass times s. What is
about the task and not the robot (distances, times, the arrival radius) stays.
"""

from dataclasses import replace

from arrive.config import Config
from arrive.robots.robot import Robot

DIGITS = 4
"""Leading digits that fitted figures keep, for people to read."""


def for_robot(config: Config, robot: Robot) -> Config:
    """The configuration with this robot, its figures fitted to the robot's size and mass; for ANYmal C unchanged."""
    size, mass = robot.size, robot.mass_share
    observation, random, task = config.observation, config.randomisation, config.task
    weight_factors = {"torque_cost": (mass * size) ** -2, "joint_acc_cost": size**2}
    rewards = {name: _scaled(weight, weight_factors.get(name, 1.0)) for name, weight in task.rewards.items()}
    return replace(
        config,
        robot=robot.name,
        observation=replace(
            observation,
            noise_heights=_scaled(observation.noise_heights, size),
            height_scale=_scaled(observation.height_scale, 1.0 / size),
            height_clip=tuple(_scaled(height, size) for height in observation.height_clip),
            grid_length=_scaled(observation.grid_length, size),
            grid_width=_scaled(observation.grid_width, size),
            grid_step=_scaled(observation.grid_step, size),
        ),
        randomisation=replace(
            random,
            payload_kg=tuple(_scaled(payload, mass) for payload in random.payload_kg),
            push_speed=_scaled(random.push_speed, size**0.5),
            start_offset=_scaled(random.start_offset, size),
        ),
        task=replace(task, target_height=_scaled(task.target_height, size), rewards=rewards),
    )


def _scaled(value: float, factor: float) -> float:
    """The product, rounded; the value itself where the factor is 1."""
    return value if factor == 1.0 else float(f"{value * factor:.{DIGITS}g}")
