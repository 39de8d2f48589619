"""Named configurations, each a plain function that builds one afresh."""

from collections.abc import Callable
from dataclasses import replace

from arrive.config import Config, ObservationConfig, PPOConfig, ScheduleConfig, TaskConfig, TerrainConfig
from arrive.errors import unknown_name

PAPER_REWARDS = {
    "task": 10.0,
    "exploration": 1.0,
    "stall_cost": -1.0,
    "joint_acc_cost": -2.5e-7,
    "torque_cost": -1e-5,
    "collision_cost": -1.0,
    "action_rate_cost": -0.01,
    "foot_acc_cost": -4e-6,
}
"""Weights of the paper's terms; it gives none itself: the task's from the UWLab position tasks, the costs' from
legged_gym."""


def paper() -> Config:
    """The paper to the letter; where it is silent, legged_gym."""
    return Config(
        preset="paper",
        num_envs=4096,
        task=TaskConfig(rewards=dict(PAPER_REWARDS)),
        ppo=PPOConfig(),
    )


def robust() -> Config:
    """What trained best on two cores; the README says what differs from the paper and why."""
    return Config(
        preset="robust",
        num_envs=1024,
        terrain=TerrainConfig(levels=30),
        observation=ObservationConfig(
            height_scale=2.0, height_clip=(-1.0, 0.4), grid_length=2.0, grid_width=1.25, grid_step=0.125
        ),
        task=TaskConfig(
            episode_s=8.0,
            episode_min_s=5.0,
            reward_window_s=2.0,
            target_distance=(0.5, 5.5),
            crossing_share=0.6,
            exploration_kept=1.0,
            approach_radius=0.2,
            demotion_share=0.5,
            rewards=PAPER_REWARDS | {"exploration": 0.0, "approach": 2.0, "stand": 10.0, "crash_cost": -2.0},
        ),
        ppo=PPOConfig(
            num_steps=24,
            gamma=0.995,
            desired_kl=0.02,
            init_std=0.5,
            hidden=(256, 128, 64),
            precision="auto",
            symmetry=True,
        ),
        schedule=ScheduleConfig(enabled=True),
    )


def joystick() -> Config:
    """For a policy that a stick leads: targets that change all the time, and pay for the speed that is asked for."""
    config = robust()
    task = replace(
        config.task,
        episode_min_s=2.0,
        target_distance=(0.0, 5.0),
        retarget_s=1.0,
        stop_share=0.2,
        rewards=config.task.rewards | {"approach": 0.0, "pace": 2.0, "pose_cost": -0.2},
    )
    return replace(
        config,
        preset="joystick",
        task=task,
        observation=replace(config.observation, noise_least=0.0),
        randomisation=replace(config.randomisation, push_interval_s=3.0),
    )


PRESETS: dict[str, Callable[[], Config]] = {"paper": paper, "robust": robust, "joystick": joystick}


def get_preset(name: str) -> Config:
    """Build a preset by name.

    Raises:
        ArriveError: no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]()
