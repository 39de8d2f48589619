"""The configuration of a run: frozen data, built fresh by a preset, changed by name, saved with the run.

The parameters of tasks, rewards, observations and physics stand beside the code that reads them; the ranges of all
fields are checked here, before anything is built.
"""

import os
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from arrive import fields
from arrive.errors import ArriveError
from arrive.fields import Count, NotNegative, Positive, Range, Rule, Share, from_dict, override, to_dict
from arrive.physics.options import PhysicsConfig
from arrive.robots import get_robot
from arrive.task.final import FinalConfig
from arrive.task.observations import ObservationConfig
from arrive.task.randomisation import RandomisationConfig
from arrive.task.registry import get_task
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
    "check",
    "from_dict",
    "override",
    "saved_config",
    "to_dict",
]

BYTES_PER_ENTRY = 25
"""Memory that training takes at its peak per observed number of a rollout: measured between 256 and 4,096 robots with
`robust` on a CPU, storage and update together."""
BYTES_ALONE = 450_000_000
"""Memory that training takes with hardly any robots."""
Precision = Literal["float32", "bfloat16", "auto"]


@dataclass(frozen=True)
class TerrainConfig:
    """Which ground the robots meet."""

    families: tuple[str, ...] = ("flat",)
    """Terrain families, by name."""
    levels: Count = 10
    """Number of levels between each family's easiest and hardest parameter."""
    variants: Count = 8
    """Different worlds per family and level: terrain where it is random, friction and payload always."""
    demotion_share: Share = 1.0
    """Share of the failures that lower the level: with q levels settle where q / (1 + q) of the episodes succeed."""


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation, as rsl_rl implements it."""

    num_steps: Count = 48
    """Policy steps per environment and iteration."""
    epochs: Count = 5
    """Passes over each batch."""
    mini_batches: Count = 4
    """Mini-batches per pass."""
    gamma: Share = 0.99
    """Discount per policy step."""
    lam: Share = 0.95
    """Lambda of the generalised advantage estimate."""
    clip: Positive = 0.2
    """Clip range of the probability ratio and of the value."""
    learning_rate: Positive = 1e-3
    """First learning rate; adapted to the KL divergence."""
    desired_kl: NotNegative = 0.01
    """KL divergence per update that the learning rate is adapted to; 0 keeps the rate fixed."""
    entropy: NotNegative = 0.005
    """Weight of the entropy bonus."""
    value_loss: NotNegative = 1.0
    """Weight of the value loss."""
    max_grad_norm: Positive = 1.0
    """Gradients are clipped to this norm."""
    init_std: Positive = 1.0
    """First standard deviation of the action noise, whose logarithm is learnt."""
    hidden: Annotated[tuple[int, ...], Range(1)] = (512, 256, 128)
    """Hidden layers of actor and critic."""
    precision: Precision = "float32"
    """Arithmetic of the hidden layers in training; `auto` takes bfloat16 on CPUs that multiply it in hardware. Weights,
    losses, evaluation and exported policies are float32 always."""
    symmetry: bool = False
    """Whether the networks treat the robot's mirror images alike, left and right and, where it has that symmetry, front
    and back."""


@dataclass(frozen=True)
class ScheduleConfig:
    """How training changes once a gait is found, and towards its end. Until then `ppo` and `task` hold."""

    enabled: bool = False
    """Whether anything changes."""
    climb_std: Positive = 0.4
    """Bound on the action noise's standard deviation while the levels rise; it falls from this to `finish_std`."""
    climb_entropy: NotNegative = 0.0
    """Weight of the entropy bonus while the levels rise."""
    climb_kl: NotNegative = 0.02
    """KL divergence per update while the levels rise."""
    climb_crash_cost: NotNegative = 6.0
    """What a crash costs while the levels rise."""
    climb_review: Annotated[float, Range(0.0, 1.0, below=True)] = 0.25
    """Share of the episodes on a random easier level while the levels rise."""
    finish_from: Share = 0.75
    """Share of the budget at which the finish begins; 1 for none."""
    finish_std: Positive = 0.15
    """Bound on the action noise's standard deviation in the end."""
    finish_kl: NotNegative = 0.01
    """KL divergence per update in the end."""
    finish_crash_cost: NotNegative = 10.0
    """What a crash costs in the end."""
    finish_review: Annotated[float, Range(0.0, 1.0, below=True)] = 0.5
    """Share of the episodes on a random easier level in the end."""


@dataclass(frozen=True)
class Config:
    """Everything that decides what a run does."""

    preset: str = "paper"
    """The named configuration that this one is made from, see `arrive list presets`."""
    robot: str = "anymal_c"
    """The robot, see `arrive list robots`."""
    num_envs: Count = 1024
    """Robots simulated side by side."""
    seed: Annotated[int, Range(0, 2**32 - 1)] = 1
    """Seed of networks, terrain and everything random."""
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    task: TaskConfig = field(default_factory=FinalConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)

    def rules(self) -> tuple[Rule, ...]:
        """What fields must be because of others."""
        batch, families = self.num_envs * self.ppo.num_steps, len(self.terrain.families)
        mass, step, robots = base_mass(self.robot), self.physics.control_dt, robots_that_fit(self)
        offset, level = self.randomisation.start_offset, START_RADIUS * get_robot(self.robot).size
        return (
            Rule("ppo.mini_batches", f"at most the batch of {batch}", self.ppo.mini_batches <= batch),
            Rule("num_envs", f"at least the number of terrain families, {families}", self.num_envs >= families),
            Rule("num_envs", f"at most {robots}, as many as this machine's memory holds", self.num_envs <= robots),
            Rule(
                "randomisation.payload_kg",
                f"above -{mass:g}, or nothing is left of the base",
                self.randomisation.payload_kg[0] > -mass,
            ),
            Rule(
                "randomisation.payload_kg",
                f"at most {10.0 * mass:g}, ten times the base",
                self.randomisation.payload_kg[1] <= 10.0 * mass,
            ),
            Rule("randomisation.start_offset", f"at most {level:g}, as far as the ground is level", offset <= level),
            Rule("task.episode_s", f"at least a policy step, {step:g} s", self.task.episode_s >= step),
        )


def robots_that_fit(config: Config) -> int:
    """How many robots can be trained in this machine's memory."""
    terms = get_task(config.task.name).observation_terms(config.task, config.observation, get_robot(config.robot))
    per_robot = BYTES_PER_ENTRY * sum(term.size for term in terms) * config.ppo.num_steps
    return max(memory_bytes() - BYTES_ALONE, 0) // per_robot


@cache
def memory_bytes() -> int:
    """Memory of this machine, or what its control group lets this process have."""
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(whole, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):  # no such group, or "max"
        return whole


@cache
def base_mass(robot: str) -> float:
    """Mass of a robot's base without payload [kg]."""
    built = get_robot(robot)
    return float(built.build_spec(False).compile().body(built.base_body).mass[0])


def saved_config(data: dict[str, Any], source: Path) -> Config:
    """The configuration that a file has kept.

    Raises:
        ArriveError: it is damaged, or another version of this software made it.
    """
    try:
        return from_dict(Config, data)
    except ArriveError as error:
        raise ArriveError(f"cannot read {source}: made by another version of arrive? {error}") from error


def check(config: Config) -> None:
    """Make sure that a configuration can be run before anything is built from it.

    Raises:
        ArriveError: an unknown robot or terrain, or fields out of range: one line that names each with its value and
            its range.
    """
    get_robot(config.robot)
    for name in config.terrain.families:
        get_family(name)
    fields.check(config)
