"""The configuration of a run: frozen data that a preset builds, `--set` changes by name, and the run saves.

The parameters of tasks, rewards, observations and physics are defined beside the code that uses them. `check_config`
tests the ranges of all fields before anything is built.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import arrive.task.registry  # noqa: F401  (a saved configuration is read by its task's fields)
from arrive.errors import ArriveError, brief
from arrive.field_values import from_dict, override, to_dict
from arrive.fields import (
    SEED,
    AtLeastOne,
    NotNegative,
    Positive,
    Range,
    Rule,
    Share,
    check_fields,
)
from arrive.physics.options import LEAST_TIME_STEPS, PhysicsConfig
from arrive.robots import Robot, get_robot
from arrive.task.final import FinalConfig
from arrive.task.observations import ObservationConfig
from arrive.task.randomisation import RandomisationConfig
from arrive.task.task import TaskConfig
from arrive.terrain import get_family
from arrive.terrain.tile import START_RADIUS

__all__ = [
    "Config",
    "ObservationConfig",
    "PPOConfig",
    "RandomisationConfig",
    "ScheduleConfig",
    "TerrainConfig",
    "check_config",
    "from_dict",
    "override",
    "saved_config",
    "to_dict",
]

Precision = Literal["float32", "bfloat16", "auto"]


@dataclass(frozen=True)
class TerrainConfig:
    """The terrain to train on."""

    families: tuple[str, ...] = ("flat",)
    """Names of the terrain families."""
    levels: AtLeastOne = 10
    """Number of levels, from each family's easiest to its hardest parameter."""
    variants: AtLeastOne = 8
    """Number of worlds per family and level. They differ in friction and payload, and in terrain if it is random."""
    demotion_share: Share = 1.0
    """Probability that a failure lowers the level. With q, levels stop rising at a success rate of q / (1 + q)."""


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation, as rsl_rl implements it."""

    num_steps: AtLeastOne = 48
    """Policy steps per environment and iteration."""
    epochs: AtLeastOne = 5
    """Passes over each batch."""
    mini_batches: AtLeastOne = 4
    """Mini-batches per pass."""
    gamma: Share = 0.99
    """Discount per policy step."""
    lam: Share = 0.95
    """Lambda of the generalised advantage estimate."""
    clip: Positive = 0.2
    """Clip range of the probability ratio and of the value."""
    learning_rate: Annotated[float, Range(0.0, 1.0, above=True)] = 1e-3
    """First learning rate; adapted to the KL divergence."""
    desired_kl: NotNegative = 0.01
    """KL divergence per update that the learning rate is adapted to; 0 keeps the rate fixed."""
    entropy: Annotated[float, Range(0.0, 10.0)] = 0.005
    """Weight of the entropy bonus."""
    value_loss: NotNegative = 1.0
    """Weight of the value loss."""
    max_grad_norm: Positive = 1.0
    """Gradients are clipped to this norm."""
    init_std: Positive = 1.0
    """Initial standard deviation of the action noise. Its logarithm is learnt."""
    hidden: Annotated[tuple[int, ...], Range(1)] = (512, 256, 128)
    """Sizes of the hidden layers of actor and critic."""
    precision: Precision = "float32"
    """Arithmetic of the hidden layers in training. `auto` takes bfloat16 on CPUs that multiply it in hardware. Weights,
    losses, evaluation and exported policies are always float32."""
    symmetry: bool = False
    """Whether the networks treat a target behind as a target ahead of the reflected robot. Without effect on a robot
    that is not symmetric front to back."""


@dataclass(frozen=True)
class ScheduleConfig:
    """Changes during training: the climb, once a gait is found, and the finish. Before that, `ppo` and `task` apply."""

    enabled: bool = False
    """Whether to use the schedule."""
    calm_gait: bool = False
    """Whether pushes and new targets within an episode begin only once a gait is found."""
    decimation: Annotated[int, Range(0)] = 0
    """Physics steps per policy step while the levels rise: fewer and longer ones than `physics.decimation` make
    training faster. 0 for `physics.decimation` throughout. It has no effect with `physics.motor=network`."""
    climb_std: Positive = 0.4
    """Bound on the action noise's standard deviation while the levels rise; it falls from this to `finish_std`."""
    climb_entropy: Annotated[float, Range(0.0, 10.0)] = 0.0
    """Weight of the entropy bonus while the levels rise."""
    climb_kl: NotNegative = 0.02
    """KL divergence per update while the levels rise."""
    climb_crash_cost: NotNegative = 6.0
    """Cost of a crash while the levels rise."""
    climb_review: Annotated[float, Range(0.0, 1.0, below=True)] = 0.25
    """Share of the episodes on a random easier level while the levels rise."""
    finish_from: Share = 0.75
    """Share of the budget after which the finish begins; 1 for no finish."""
    finish_std: Positive = 0.15
    """Upper bound on the standard deviation of the action noise at the end of training."""
    finish_kl: NotNegative = 0.01
    """KL divergence per update at the end of training."""
    finish_crash_cost: NotNegative = 10.0
    """Cost of a crash at the end of training."""
    finish_review: Annotated[float, Range(0.0, 1.0, below=True)] = 0.5
    """Share of the episodes on a random easier level at the end of training."""


@dataclass(frozen=True)
class Config:
    """Everything that determines a run."""

    preset: str = "paper"
    """The preset that this configuration started from, see `arrive list presets`."""
    robot: str = "anymal_c"
    """The robot, see `arrive list robots`."""
    num_envs: AtLeastOne = 1024
    """Robots simulated side by side."""
    seed: Annotated[int, SEED] = 1
    """Seed of networks, terrain and everything random."""
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    task: TaskConfig = field(default_factory=FinalConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between fields."""
        batch, families = self.num_envs * self.ppo.num_steps, len(self.terrain.families)
        robot, step = get_robot(self.robot), self.physics.control_dt
        mass, fewest = base_mass(robot), fewest_steps(robot, step)
        offset, level = self.randomisation.start_offset, START_RADIUS * robot.size
        return (
            Rule("ppo.mini_batches", f"at most the batch of {batch}", self.ppo.mini_batches <= batch),
            Rule("num_envs", f"at least the number of terrain families, {families}", self.num_envs >= families),
            Rule(
                "randomisation.payload_kg",
                f"above -{mass:g}, the base's own mass",
                self.randomisation.payload_kg[0] > -mass,
            ),
            Rule(
                "randomisation.payload_kg",
                f"at most {10.0 * mass:g}, ten times the base's mass",
                self.randomisation.payload_kg[1] <= 10.0 * mass,
            ),
            Rule("randomisation.start_offset", f"at most {level:g}, where the ground is level", offset <= level),
            Rule("task.episode_s", f"at least one policy step, {step:g} s", self.task.episode_s >= step),
            Rule(
                "schedule.decimation",
                f"0, or at least {fewest}: the limits of the robot's joints need physics steps that short",
                self.schedule.decimation == 0 or self.schedule.decimation >= fewest,
            ),
        )


def base_mass(robot: Robot) -> float:
    """Mass of a robot's base without payload [kg]."""
    return float(robot.model.body(robot.base_body).mass[0])


def fewest_steps(robot: Robot, control_dt: float) -> int:
    """Fewest physics steps per policy step for which MuJoCo takes the robot's joint limits as they are."""
    model = robot.model
    time_s = model.jnt_solref[model.jnt_limited.astype(bool), 0]
    shortest = time_s[time_s > 0.0].min(initial=math.inf)
    return max(math.ceil(LEAST_TIME_STEPS * control_dt / shortest - 1e-9), 1)


def saved_config(data: dict[str, Any], source: Path) -> Config:
    """The configuration saved in a file.

    Raises:
        ArriveError: the file is damaged, was written by another version of arrive, or has values out of range.
    """
    try:
        config = from_dict(Config, data)
        check_config(config)
        return config
    except ArriveError as error:
        fault = brief(str(error))
        raise ArriveError(f"cannot read {source}: was it made by another version of arrive? {fault}") from error


def check_config(config: Config) -> None:
    """Check a configuration before anything is built from it.

    Raises:
        ArriveError: an unknown robot or terrain, or fields out of range; one line names each field, its value and its
            range.
    """
    get_robot(config.robot)
    for name in config.terrain.families:
        get_family(name)
    check_fields(config)
