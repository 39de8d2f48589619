"""The values of result files that a report, a card or another command reads, as types."""

from typing import Annotated, Any, NotRequired, TypedDict

from arrive.fields import AtLeastOne, NotNegative, Positive, Range, Share

Quantity = Annotated[float, Range(-1e9, 1e9)]
"""A length, an angle, a speed or a cost."""
Count = Annotated[int, Range(0, 2**53)]
Samples = Annotated[float, Range(0.0, 1e15)]
Pair = tuple[Quantity, Quantity]
ShareInterval = tuple[Share, Share]
"""Ends of the 95 % interval of a share."""
Estimate = tuple[Quantity, Quantity, Quantity]
"""A value with the ends of its 95 % interval."""
Quartiles = tuple[NotNegative, NotNegative, NotNegative]


class Level(TypedDict):
    """Success at one value of a terrain's parameter."""

    value: Quantity
    episodes: AtLeastOne
    success: Share
    interval: ShareInterval
    failures: dict[str, Count]


class Solved(TypedDict):
    """One terrain family of difficulty.json."""

    levels: list[Level]
    unit: str
    max_at_95: Quantity | None
    max_at_80: Quantity | None
    max_at_50: Quantity | None


class Profile(TypedDict):
    """Mean speed over time; as many speeds as times."""

    time_s: list[NotNegative]
    mean_m_s: list[Quantity]


class Usage(TypedDict):
    """Time, path and speed of the successful episodes of one level; only the value if there are none."""

    value: Quantity
    episodes: Count
    arrival_time_s: NotRequired[Quartiles]
    path_length_m: NotRequired[Quartiles]
    speed_profile: NotRequired[Profile]
    motion: NotRequired[dict[str, Quantity | None]]


class MeasuredPolicy(TypedDict):
    """The measured policy, and the figures of its successful episodes by terrain family."""

    samples: Samples
    usage: dict[str, list[Usage]]


class TrialProtocol(TypedDict):
    """The command of every episode."""

    duration_s: Positive
    target: Pair
    speed: Quantity
    walk: Quantity


class RandomisationProtocol(TypedDict):
    """What differs between robots and their worlds."""

    friction: Pair
    payload_kg: Pair
    start_yaw_rad: Quantity
    start_offset: Quantity
    start_speed: Quantity
    start_joint_scale: Quantity


class DifficultyProtocol(TypedDict):
    """How difficulty.json was measured."""

    episodes: AtLeastOne
    seed: Count
    levels: AtLeastOne | None
    terrain_m: Quantity
    trial: TrialProtocol
    arrival_radius_m: Quantity
    worlds_per_level: AtLeastOne
    randomisation: RandomisationProtocol
    observation_noise: bool
    success: str
    note: str


class ExportedDifficulty(TypedDict):
    """The measurement in an exported file."""

    families: dict[str, Solved]
    protocol: DifficultyProtocol
    commit: str


class DifficultyResult(ExportedDifficulty):
    """difficulty.json, of `arrive eval --protocol difficulty`."""

    policy: MeasuredPolicy


class Training(TypedDict):
    """The training in an exported file."""

    config: dict[str, Any]
    commit: str
    samples: Samples


class RunRecord(TypedDict):
    """config.json of a run."""

    config: dict[str, Any]
    commit: str
    command: str
    seed: Count
    samples_before: NotRequired[Count]
    imports: NotRequired[dict[str, str]]


class ShippedTask(TypedDict):
    """The task of a shipped policy; `retarget_s` above 0 means that its targets moved."""

    retarget_s: NotRequired[NotNegative]


class ShippedTerrain(TypedDict):
    """The terrain that a shipped policy was trained on."""

    families: list[str]


class ShippedConfig(TypedDict):
    """The fields of a shipped policy's configuration that `arrive list` shows."""

    robot: str
    terrain: ShippedTerrain
    task: ShippedTask


class Shipped(TypedDict):
    """config.json of a shipped policy. `arrive list` reads it without loading the code of the tasks."""

    config: ShippedConfig


class AtDistance(TypedDict):
    """Success at one distance and time."""

    distance_m: NotNegative
    time_s: Positive
    episodes: AtLeastOne
    success: Share
    interval: ShareInterval
    failures: dict[str, Count]
    stood_at_m: NotRequired[NotNegative]


class InDirection(TypedDict):
    """Success in one direction."""

    direction_deg: Quantity
    episodes: AtLeastOne
    success: Share
    interval: ShareInterval
    failures: dict[str, Count]


class Waiting(TypedDict):
    """Robots that arrived, and those of them that stayed; share and interval are None if no robot arrived."""

    wait_s: NotNegative
    time_s: Positive
    arrived: Count
    stayed: Count
    share: Share | None
    interval: ShareInterval | None
    failures: dict[str, Count]


class Reached(TypedDict):
    """One terrain family of reach.json."""

    value: Quantity
    distances: list[AtDistance]
    directions: list[InDirection]
    waiting: Waiting


class ReachProtocol(TypedDict):
    """How reach.json was measured."""

    episodes: AtLeastOne
    seed: Count
    layout: str
    distances_m: list[Quantity]
    directions_deg: list[Quantity]
    times_s: list[Quantity]
    success: str
    by_distance: str
    by_direction: str


class ReachResult(TypedDict):
    """reach.json, of `arrive eval --protocol reach`."""

    families: dict[str, Reached]
    protocol: ReachProtocol
    commit: str


class WalkingCost(TypedDict):
    """Cost of walking at one speed; None if fewer than two robots walked."""

    told_m_s: Quantity
    robots: AtLeastOne
    fell: Count
    stood: Count
    torque_sq: Estimate | None
    positive_work: Estimate | None
    absolute_work: Estimate | None
    cost_of_transport: Estimate | None
    speed: Estimate | None
    time_s: Estimate | None


class ComparedPolicy(TypedDict):
    """One of several measured policies, and its training."""

    name: str
    task: str
    seed: NotRequired[Count]
    samples: Samples
    commit: str


class EnergyPolicy(ComparedPolicy):
    """One policy of energy.json."""

    speeds: list[WalkingCost]


class Commands(TypedDict):
    """The command of each task, in words."""

    velocity: str
    final: str
    continuous: str


class EnergyProtocol(TypedDict):
    """How energy.json was measured."""

    robots: AtLeastOne
    way_m: Positive
    seed: Count
    command: Commands
    counted: str


class EnergyResult(TypedDict):
    """energy.json, of `arrive energy`."""

    policies: list[EnergyPolicy]
    protocol: EnergyProtocol
    commit: str


class GaitRow(TypedDict):
    """The gait at one speed and direction; `gait` is None if too few robots made complete strides."""

    told_m_s: Quantity
    direction_deg: Quantity
    fell: Count
    gait: str | None


class Diagram(TypedDict):
    """Contacts of the feet of a typical robot: 0 or 1 per foot and step."""

    dt_s: Positive
    stands: list[list[Annotated[int, Range(0, 1)]]]


class Hildebrand(TypedDict):
    """A gait's position in Hildebrand's diagram [strides]."""

    hind_duty: Share
    fore_after_hind: Quantity


class SteppingRow(GaitRow):
    """A row with a gait, with its figures."""

    duty: list[Estimate]
    phase: list[Quantity]
    speed_m_s: Estimate
    stride_frequency_hz: Estimate
    stride_length_m: Estimate
    travel_deg: Quantity
    hildebrand: Hildebrand | None
    diagram: Diagram


class GaitPolicy(ComparedPolicy):
    """One policy of gait.json."""

    feet: list[str]
    gaits: list[GaitRow]


class GaitProtocol(TypedDict):
    """How gait.json was measured."""

    robots: AtLeastOne
    seconds: Positive
    settle_s: NotNegative
    seed: Count
    together: NotNegative


class GaitResult(TypedDict):
    """gait.json, of `arrive gait`."""

    policies: list[GaitPolicy]
    protocol: GaitProtocol
    commit: str


class CriticCurve(TypedDict):
    """Explained variance of the value function over samples; as many values as samples."""

    samples: list[Samples]
    explained_variance: list[Quantity]


class StabilityRun(TypedDict):
    """One training of stability.json."""

    ground: str
    variant: str
    success: Share
    explained_variance: Quantity
    value_loss: Quantity
    curve: CriticCurve


class StabilityProtocol(TypedDict):
    """How stability.json was measured."""

    preset: str
    samples: Samples
    goal: Share
    grounds: list[str]
    seeds: list[Count]
    episodes: AtLeastOne


class StabilityResult(TypedDict):
    """stability.json, of benchmarks/stability.py."""

    runs: list[StabilityRun]
    variants: dict[str, str]
    protocol: StabilityProtocol
    command: str
    commit: str


class WindowRun(TypedDict):
    """One training of time_window.json; arrival time, path and speed profile are None if no robot arrived."""

    window_s: NotNegative
    seed: Count
    success: Share
    interval: ShareInterval
    arrival_time_s: Quartiles | None
    path_length_m: Quartiles | None
    speed_profile: Profile | None
    energy: tuple[WalkingCost, ...]


class WindowProtocol(TypedDict):
    """How time_window.json was measured."""

    preset: str
    ground: str
    samples: Samples
    episodes: AtLeastOne
    episode_s: Positive
    seeds: list[Count]


class WindowResult(TypedDict):
    """time_window.json, of benchmarks/time_window.py."""

    runs: list[WindowRun]
    protocol: WindowProtocol
    command: str
    commit: str
