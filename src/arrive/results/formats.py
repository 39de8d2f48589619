"""What result files hold, as far as a report, a card or another command reads it."""

from collections.abc import Callable
from typing import Annotated, Any, NotRequired, TypedDict

from arrive.errors import ArriveError
from arrive.fields import Range, Share
from arrive.results.check import check_data

NotNegative = Annotated[float, Range(0.0, 1e9)]
Positive = Annotated[float, Range(0.0, 1e9, above=True)]
Value = Annotated[float, Range(-1e9, 1e9)]
"""Of a length, an angle, a speed or a cost."""
Count = Annotated[int, Range(0, 2**53)]
AtLeastOne = Annotated[int, Range(1, 2**53)]
Samples = Annotated[float, Range(0.0, 1e15)]
Pair = tuple[Value, Value]
Interval = tuple[Share, Share]
"""Ends of the 95 % interval of a share."""
Estimate = tuple[Value, Value, Value]
"""A value with the ends of its 95 % interval."""
Quartiles = tuple[NotNegative, NotNegative, NotNegative]


class Level(TypedDict):
    """Success at one value of a terrain's parameter."""

    value: Value
    episodes: AtLeastOne
    success: Share
    interval: Interval
    failures: dict[str, Count]


class Solved(TypedDict):
    """One terrain family of difficulty.json."""

    levels: list[Level]
    unit: str
    max_at_95: Value | None
    max_at_80: Value | None
    max_at_50: Value | None


class Profile(TypedDict):
    """Mean speed over time; as many speeds as times."""

    time_s: list[NotNegative]
    mean_m_s: list[Value]


class Usage(TypedDict):
    """How the successful episodes of one level went; without episodes nothing but the value."""

    value: Value
    episodes: Count
    arrival_time_s: NotRequired[Quartiles]
    path_length_m: NotRequired[Quartiles]
    speed_profile: NotRequired[Profile]
    motion: NotRequired[dict[str, Value | None]]


class MeasuredPolicy(TypedDict):
    """The policy that was measured, and how its robots spent their time by terrain family."""

    samples: Samples
    usage: dict[str, list[Usage]]


class Trial(TypedDict):
    """What robots are asked for."""

    duration_s: Positive
    target: Pair
    speed: Value
    walk: Value


class Start(TypedDict):
    """How robots and their worlds differ."""

    friction: Pair
    payload_kg: Pair
    start_yaw_rad: Value
    start_offset: Value
    start_speed: Value
    start_joint_scale: Value


class DifficultyProtocol(TypedDict):
    """How difficulty.json was measured."""

    episodes: AtLeastOne
    seed: Count
    levels: AtLeastOne | None
    terrain_m: Value
    trial: Trial
    arrival_radius_m: Value
    worlds_per_level: AtLeastOne
    randomisation: Start
    observation_noise: bool
    success: str
    note: str


class ExportedDifficulty(TypedDict):
    """What an exported file says of its measurement."""

    families: dict[str, Solved]
    protocol: DifficultyProtocol
    commit: str


class Difficulty(ExportedDifficulty):
    """difficulty.json, of `arrive eval --protocol difficulty`."""

    policy: MeasuredPolicy


class Training(TypedDict):
    """What an exported file says of its training."""

    config: dict[str, Any]
    commit: str
    samples: Samples


class Record(TypedDict):
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
    """What a shipped policy was trained on."""

    families: list[str]


class ShippedConfig(TypedDict):
    """What `arrive list` says of a shipped policy."""

    robot: str
    terrain: ShippedTerrain
    task: ShippedTask


class Shipped(TypedDict):
    """config.json of a shipped policy, as far as `arrive list` reads it without loading the code of the tasks."""

    config: ShippedConfig


class AtDistance(TypedDict):
    """Success at one distance and time."""

    distance_m: NotNegative
    time_s: Positive
    episodes: AtLeastOne
    success: Share
    interval: Interval
    failures: dict[str, Count]
    stood_at_m: NotRequired[NotNegative]


class InDirection(TypedDict):
    """Success in one direction."""

    direction_deg: Value
    episodes: AtLeastOne
    success: Share
    interval: Interval
    failures: dict[str, Count]


class Waiting(TypedDict):
    """How many of the robots that arrived stayed; share and interval are None where nobody arrived."""

    wait_s: NotNegative
    time_s: Positive
    arrived: Count
    stayed: Count
    share: Share | None
    interval: Interval | None
    failures: dict[str, Count]


class Reached(TypedDict):
    """One terrain family of reach.json."""

    value: Value
    distances: list[AtDistance]
    directions: list[InDirection]
    waiting: Waiting


class ReachProtocol(TypedDict):
    """How reach.json was measured."""

    episodes: AtLeastOne
    seed: Count
    layout: str
    distances_m: list[Value]
    directions_deg: list[Value]
    times_s: list[Value]
    success: str
    by_distance: str
    by_direction: str


class Reach(TypedDict):
    """reach.json, of `arrive eval --protocol reach`."""

    families: dict[str, Reached]
    protocol: ReachProtocol
    commit: str


class Walk(TypedDict):
    """What walking at one speed costs; None where fewer than two robots walked."""

    told_m_s: Value
    robots: AtLeastOne
    fell: Count
    stood: Count
    torque_sq: Estimate | None
    positive_work: Estimate | None
    absolute_work: Estimate | None
    cost_of_transport: Estimate | None
    speed: Estimate | None
    time_s: Estimate | None


class Measured(TypedDict):
    """Where a policy is from that was measured beside others."""

    name: str
    task: str
    seed: NotRequired[Count]
    samples: Samples
    commit: str


class Walker(Measured):
    """One policy of energy.json."""

    speeds: list[Walk]


class Commands(TypedDict):
    """What each task is told, in words."""

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


class Energy(TypedDict):
    """energy.json, of `arrive energy`."""

    policies: list[Walker]
    protocol: EnergyProtocol
    commit: str


class Gait(TypedDict):
    """Steps at one speed and direction; `gait` is None where too few robots made whole strides."""

    told_m_s: Value
    direction_deg: Value
    fell: Count
    gait: str | None


class Diagram(TypedDict):
    """When the feet of a typical robot stand: 0 or 1 per foot and step."""

    dt_s: Positive
    stands: list[list[Annotated[int, Range(0, 1)]]]


class Hildebrand(TypedDict):
    """Where a gait lies between Hildebrand's axes [strides]."""

    hind_duty: Share
    fore_after_hind: Value


class Steps(Gait):
    """A row of robots that walk."""

    duty: list[Estimate]
    phase: list[Value]
    speed_m_s: Estimate
    stride_frequency_hz: Estimate
    stride_length_m: Estimate
    travel_deg: Value
    hildebrand: Hildebrand | None
    diagram: Diagram


class Stepper(Measured):
    """One policy of gait.json."""

    feet: list[str]
    gaits: list[Gait]


class GaitProtocol(TypedDict):
    """How gait.json was measured."""

    robots: AtLeastOne
    seconds: Positive
    settle_s: NotNegative
    seed: Count
    together: NotNegative


class Gaits(TypedDict):
    """gait.json, of `arrive gait`."""

    policies: list[Stepper]
    protocol: GaitProtocol
    commit: str


class CriticCurve(TypedDict):
    """Explained variance of the value function over samples; as many values as samples."""

    samples: list[Samples]
    explained_variance: list[Value]


class StabilityRun(TypedDict):
    """One training of stability.json."""

    ground: str
    variant: str
    success: Share
    explained_variance: Value
    value_loss: Value
    curve: CriticCurve


class StabilityProtocol(TypedDict):
    """How stability.json was measured."""

    preset: str
    samples: Samples
    goal: Share
    grounds: list[str]
    seeds: list[Count]
    episodes: AtLeastOne


class Stability(TypedDict):
    """stability.json, of benchmarks/stability.py."""

    runs: list[StabilityRun]
    variants: dict[str, str]
    protocol: StabilityProtocol
    command: str
    commit: str


class WindowRun(TypedDict):
    """One training of time_window.json; the figures of its ways are None where nobody arrived."""

    window_s: NotNegative
    seed: Count
    success: Share
    interval: Interval
    arrival_time_s: Quartiles | None
    path_length_m: Quartiles | None
    speed_profile: Profile | None
    energy: tuple[Walk, ...]


class WindowProtocol(TypedDict):
    """How time_window.json was measured."""

    preset: str
    ground: str
    samples: Samples
    episodes: AtLeastOne
    episode_s: Positive
    seeds: list[Count]


class Window(TypedDict):
    """time_window.json, of benchmarks/time_window.py."""

    runs: list[WindowRun]
    protocol: WindowProtocol
    command: str
    commit: str


def check_usage(content: dict[str, Any]) -> None:
    """Check what the types of difficulty.json cannot say: levels with episodes have figures, of equal length.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for name, rows in content["policy"]["usage"].items():
        for i, row in enumerate(rows):
            where = f"policy.usage.{name}[{i}]"
            if row["episodes"]:
                _need(row, ("arrival_time_s", "path_length_m", "speed_profile"), where)
            if "speed_profile" in row:
                _equal(row["speed_profile"], "time_s", "mean_m_s", f"{where}.speed_profile")


def check_reach(content: dict[str, Any]) -> None:
    """Check what the types of reach.json cannot say: every distance was measured once for every time given.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for name, entry in content["families"].items():
        where, rows = f"families.{name}", [(row["distance_m"], row["time_s"]) for row in entry["distances"]]
        times, distances = {time for _, time in rows}, {distance for distance, _ in rows}
        if len(rows) != len(set(rows)) or len(rows) != len(times) * len(distances):
            raise ArriveError(f"{where}.distances must have one row for each distance and time")
        if entry["waiting"]["time_s"] not in times:
            raise ArriveError(f"{where}.waiting.time_s must be one of the times of {where}.distances")
        if entry["waiting"]["arrived"]:
            for key in ("share", "interval"):
                if entry["waiting"][key] is None:
                    raise ArriveError(f"{where}.waiting.{key} must not be null, for robots arrived")


def check_gaits(content: dict[str, Any]) -> None:
    """Check what the types of gait.json cannot say: rows with a gait have its figures, and a line for every foot.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for i, policy in enumerate(content["policies"]):
        for j, row in enumerate(policy["gaits"]):
            where = f"policies[{i}].gaits[{j}]"
            if row["gait"] is not None:
                check_data(Steps, row, where)
                if len(row["diagram"]["stands"]) != len(policy["feet"]):
                    raise ArriveError(f"{where}.diagram.stands must have a list for each of the policy's feet")


def check_stability(content: dict[str, Any]) -> None:
    """Check what the types of stability.json cannot say: curves have as many values as samples, and there are variants.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    if not content["variants"]:
        raise ArriveError("variants must have at least one name")
    for i, run in enumerate(content["runs"]):
        _equal(run["curve"], "samples", "explained_variance", f"runs[{i}].curve")


def check_window(content: dict[str, Any]) -> None:
    """Check what the types of time_window.json cannot say: who arrived has a path, a time and a speed profile.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for i, run in enumerate(content["runs"]):
        figures = [run[key] is None for key in ("arrival_time_s", "path_length_m", "speed_profile")]
        if any(figures) and not all(figures):
            raise ArriveError(f"runs[{i}] must have arrival_time_s, path_length_m and speed_profile, or none of them")
        if run["speed_profile"]:
            _equal(run["speed_profile"], "time_s", "mean_m_s", f"runs[{i}].speed_profile")
        check_walks(run["energy"], f"runs[{i}].energy")


def check_walks(rows: list[dict[str, Any]], where: str) -> None:
    """Check that a row with a cost has the speed at which it was paid.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for i, row in enumerate(rows):
        if row["speed"] is None and (row["torque_sq"] or row["cost_of_transport"]):
            raise ArriveError(f"{where}[{i}].speed must not be null where there are costs")


def check_energy(content: dict[str, Any]) -> None:
    """Check what the types of energy.json cannot say.

    Raises:
        ArriveError: it is not so; the message says where.
    """
    for i, policy in enumerate(content["policies"]):
        check_walks(policy["speeds"], f"policies[{i}].speeds")


def _need(row: dict[str, Any], names: tuple[str, ...], where: str) -> None:
    for name in names:
        if name not in row:
            raise ArriveError(f"{where}.{name} is missing")


def _equal(row: dict[str, Any], first: str, second: str, where: str) -> None:
    if len(row[first]) != len(row[second]):
        raise ArriveError(f"{where}.{second} must have as many values as {first}, {len(row[first])}")


Check = Callable[[dict[str, Any]], None]


def _nothing(content: dict[str, Any]) -> None:
    pass


FORMATS: dict[str, tuple[type, Check]] = {
    "difficulty": (Difficulty, check_usage),
    "exported": (ExportedDifficulty, _nothing),
    "training": (Training, _nothing),
    "record": (Record, _nothing),
    "shipped": (Shipped, _nothing),
    "reach": (Reach, check_reach),
    "energy": (Energy, check_energy),
    "gait": (Gaits, check_gaits),
    "stability": (Stability, check_stability),
    "time_window": (Window, check_window),
}
"""Type and further check of each format. Results call themselves by these names, in `protocol.name`."""
