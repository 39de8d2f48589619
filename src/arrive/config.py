"""The configuration of a run: frozen data, built fresh by a preset, changed by name, saved with the run."""

import dataclasses
import json
import types
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin, get_type_hints

from arrive.errors import ArriveError, unknown_name
from arrive.physics.options import PhysicsConfig

Precision = Literal["float32", "bfloat16", "auto"]


@dataclass(frozen=True)
class ObservationConfig:
    """What the policy senses; noise figures are half-widths of uniform noise."""

    noise: bool = True
    """Whether noise is added."""
    noise_least: float = 1.0
    """Least share of the noise in training: robots get shares from this to 1, evenly spread, each its own for ever."""
    noise_lin_vel: float = 0.1
    """Base linear velocity [m/s]."""
    noise_ang_vel: float = 0.2
    """Base angular velocity [rad/s]."""
    noise_gravity: float = 0.05
    """Direction of gravity."""
    noise_joint_pos: float = 0.01
    """Joint positions [rad]."""
    noise_joint_vel: float = 1.5
    """Joint velocities [rad/s]."""
    noise_heights: float = 0.1
    """Height samples [m]."""
    height_scale: float = 5.0
    """The policy receives height samples times this [1/m]."""
    height_clip: tuple[float, float] = (-1.0, 1.0)
    """Relative heights are cut at these: how far above and how far below 0.5 m under the base ground is told apart [m].
    What is deeper than any foot reaches should look the same, whether it is half a metre deep or two."""
    grid_length: float = 1.6
    """Extent of the height grid along the heading [m]."""
    grid_width: float = 1.0
    """Extent of the height grid across the heading [m]."""
    grid_step: float = 0.1
    """Distance between height samples [m]."""


@dataclass(frozen=True)
class RandomisationConfig:
    """What differs between robots and what disturbs them."""

    friction: tuple[float, float] = (0.75, 1.125)
    """Sliding friction of a contact, uniform. legged_gym deals 0.5 to 1.25 to robots, and PhysX takes the mean of that
    and the terrain's 1.0."""
    payload_kg: tuple[float, float] = (-5.0, 5.0)
    """Mass added to the base, uniform [kg]."""
    push_speed: float = 1.0
    """Largest sudden change of the base's horizontal velocity per axis [m/s]; 0 for no pushes."""
    push_interval_s: float = 15.0
    """Mean time between pushes of one robot [s]."""
    start_yaw_rad: float = 3.141592653589793
    """Start heading, uniform within this of the tile's x axis [rad]."""
    start_offset: float = 0.2
    """Start position, uniform within this of the tile's origin, per axis [m]."""
    start_speed: float = 0.5
    """Start velocity of the base, uniform within this, per axis [m/s and rad/s]."""
    start_joint_scale: float = 0.5
    """Start joint positions: the default ones times 1 +- this, uniform."""


@dataclass(frozen=True)
class TaskConfig:
    """What the robot is asked to do and paid for."""

    name: str = "final"
    """The task's recipe, one of `arrive list`."""
    episode_s: float = 6.0
    """Longest episode T [s]."""
    episode_min_s: float = 6.0
    """Shortest episode; lengths are drawn uniformly between the two [s]."""
    reward_window_s: float = 1.0
    """Duration T_r of the task reward at the end of an episode (paper, eq. 1) [s]."""
    arrival_radius: float = 0.5
    """A robot this close to its target at the end has arrived [m]."""
    target_distance: tuple[float, float] = (1.0, 5.0)
    """Distance of targets from the start, uniform [m]."""
    crossing_share: float = 0.0
    """Share of the targets that are drawn only where they count, beyond the terrain to be crossed: of all those among
    pillars, two thirds can be reached straight."""
    retarget_s: float = 0.0
    """Mean time after which a robot in training gets another target and the time for it, without an end of the episode;
    0 for never [s]."""
    stop_share: float = 0.0
    """Share of those other targets that are where the robot is: it is told to stop."""
    target_height: float = 0.5
    """Height of targets above the ground [m]."""
    rewards: dict[str, float] = field(default_factory=dict)
    """Weight of each reward term, by name; costs have negative weights."""
    exploration_until: float = 0.5
    """`exploration`, `approach` and `pace` go once the task reward in its window is this share of its maximum."""
    exploration_kept: float = 0.0
    """Share of the exploration rewards that stays after that."""
    approach_speed: float = 1.0
    """Speed towards the target at which the `approach` reward saturates [m/s]."""
    approach_radius: float = 0.5
    """Nearer to the target than this, and within the arrival radius, the `approach` reward is full [m]. At the arrival
    radius itself robots may learn to stop just there, and miss it by a centimetre."""
    demotion: Literal["any", "far"] = "any"
    """Which failures lower the level: `any`, or `far` (crash, fall, or more than half of the way left)."""
    demotion_share: float = 1.0
    """Share of those failures that do: with q the levels settle where q / (1 + q) of the episodes succeed."""
    bootstrap_timeouts: bool = False
    """Whether the value at a time-out is bootstrapped as if the episode went on; the paper argues against it."""


@dataclass(frozen=True)
class TerrainConfig:
    """Which ground the robots meet."""

    families: tuple[str, ...] = ("flat",)
    """Terrain families, by name."""
    shares: dict[str, float] = field(default_factory=dict)
    """In what proportion families get robots, by name; 1 for those that are not named."""
    levels: int = 10
    """Number of levels between each family's easiest and hardest parameter."""
    variants: int = 8
    """Different worlds per family and level: terrain where it is random, friction and payload always."""
    start_level: int = 0
    """Robots start on levels up to this one; where a run starts from another one, on the levels reached there."""
    review: float = 0.0
    """Share of the episodes on a random easier level than the robot's own, so that those are not forgotten; they move
    no level."""


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation, as rsl_rl implements it."""

    num_steps: int = 48
    """Policy steps per environment and iteration."""
    epochs: int = 5
    """Passes over each batch."""
    mini_batches: int = 4
    """Mini-batches per pass."""
    gamma: float = 0.99
    """Discount per policy step."""
    lam: float = 0.95
    """Lambda of the generalised advantage estimate."""
    clip: float = 0.2
    """Clip range of the probability ratio and of the value."""
    learning_rate: float = 1e-3
    """First learning rate; adapted to the KL divergence."""
    desired_kl: float = 0.01
    """KL divergence per update that the learning rate is adapted to; 0 keeps the rate fixed."""
    entropy: float = 0.005
    """Weight of the entropy bonus while the exploration rewards are paid."""
    entropy_after: float = 0.005
    """Weight of the entropy bonus once they are gone."""
    value_loss: float = 1.0
    """Weight of the value loss."""
    max_grad_norm: float = 1.0
    """Gradients are clipped to this norm."""
    init_std: float = 1.0
    """First standard deviation of the action noise, whose logarithm is learnt."""
    warm_std: float = 0.0
    """The same where a run starts from another's networks; 0 keeps theirs."""
    hidden: tuple[int, ...] = (512, 256, 128)
    """Hidden layers of actor and critic."""
    precision: Precision = "float32"
    """Arithmetic of the hidden layers in training; `auto` takes bfloat16 on CPUs that multiply it in hardware. Weights,
    losses, evaluation and exported policies are float32 always."""
    symmetry: bool = False
    """Whether the networks treat the robot's mirror images alike, left and right and, where it has that symmetry, front
    and back."""


@dataclass(frozen=True)
class ScheduleConfig:
    """How training changes once a gait is found, and towards its end. Until then `ppo`, `task` and `terrain` hold."""

    enabled: bool = False
    """Whether anything changes."""
    climb_std: float = 0.4
    """Bound on the action noise's standard deviation while the levels rise; it falls from this to `finish_std`."""
    climb_entropy: float = 0.0
    """Weight of the entropy bonus while the levels rise."""
    climb_kl: float = 0.02
    """KL divergence per update while the levels rise."""
    climb_crash_cost: float = 6.0
    """What a crash costs while the levels rise."""
    climb_review: float = 0.25
    """Share of the episodes on a random easier level while the levels rise."""
    finish_from: float = 0.75
    """Share of the budget at which the finish begins; 1 for none."""
    finish_std: float = 0.15
    """Bound on the action noise's standard deviation in the end."""
    finish_kl: float = 0.01
    """KL divergence per update in the end."""
    finish_crash_cost: float = 10.0
    """What a crash costs in the end."""
    finish_review: float = 0.5
    """Share of the episodes on a random easier level in the end."""


@dataclass(frozen=True)
class Config:
    """Everything that decides what a run does."""

    preset: str = "paper"
    robot: str = "anymal_c"
    num_envs: int = 1024
    """Robots simulated side by side."""
    seed: int = 1
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)


def to_dict(config: Any) -> dict[str, Any]:
    """The configuration as plain JSON data."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_dict(kind: type, data: dict[str, Any], where: str = "") -> Any:
    """Rebuild a configuration dataclass from `to_dict` data.

    Raises:
        ArriveError: a field does not exist or has the wrong type; the message names it and lists the valid ones.
    """
    hints = get_type_hints(kind)
    for name in data:
        if name not in hints:
            raise unknown_name(f"field {where}{name}; in {where or 'the configuration'}", name, hints)
    return kind(**{name: _convert(hints[name], value, f"{where}{name}") for name, value in data.items()})


def override(config: Config, assignments: tuple[str, ...]) -> Config:
    """Change fields by `path=value`, e.g. `task.rewards.stall_cost=-2` or `ppo.hidden=[128,64]`.

    Raises:
        ArriveError: malformed, or no such field.
    """
    data = to_dict(config)
    for assignment in assignments:
        path, sign, text = assignment.partition("=")
        if not sign:
            raise ArriveError(f"cannot read {assignment!r}: write PATH=VALUE, e.g. ppo.gamma=0.995")
        _assign(data, path.strip().split("."), _parse(text), path)
    return from_dict(Config, data)


def _assign(data: dict[str, Any], keys: list[str], value: Any, path: str) -> None:
    for key in keys[:-1]:
        if not isinstance(data.get(key), dict):
            raise unknown_name(f"field {path}: no", key, data)
        data = data[key]
    # A reward's weight and a family's share may be new: their names are checked where they are used.
    if keys[-1] not in data and keys[-2:-1] != ["rewards"] and keys[-2:-1] != ["shares"]:
        raise unknown_name(f"field {path}: no", keys[-1], data)
    data[keys[-1]] = value


def _parse(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return {"True": True, "False": False}.get(text, text)


def _convert(hint: Any, value: Any, where: str) -> Any:
    if (dataclasses.is_dataclass(hint) or get_origin(hint) is dict) and not isinstance(value, dict):
        raise ArriveError(f"{where} has fields of its own, it cannot be {value!r}")
    if dataclasses.is_dataclass(hint):
        return from_dict(hint, value, f"{where}.")
    origin = get_origin(hint)
    if origin is tuple:
        return _convert_tuple(hint, value, where)
    if origin is dict:
        return {str(name): _convert(get_args(hint)[1], item, f"{where}.{name}") for name, item in value.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    options = get_args(hint)
    if options and not isinstance(hint, types.UnionType):
        if value not in options:
            raise unknown_name(f"value of {where}", str(value), map(str, options))
        return value
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise ArriveError(f"{where} must be {hint.__name__}, not {value!r}")
    return value


def _convert_tuple(hint: Any, value: Any, where: str) -> tuple:
    if not isinstance(value, list | tuple):
        raise ArriveError(f"{where} must be a list, not {value!r}")
    kinds = get_args(hint)
    if kinds[-1] is not Ellipsis and len(kinds) != len(value):
        raise ArriveError(f"{where} must have {len(kinds)} entries, not {len(value)}")
    kinds = (kinds[0],) * len(value) if kinds[-1] is Ellipsis else kinds
    return tuple(_convert(kind, item, where) for kind, item in zip(kinds, value, strict=True))
