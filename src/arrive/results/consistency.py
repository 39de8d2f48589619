"""Checks of result files that their types cannot express, and the table of all formats."""

from collections.abc import Callable
from typing import Any

from arrive.errors import ArriveError
from arrive.results.check import check_data
from arrive.results.formats import (
    DifficultyResult,
    EnergyResult,
    ExportedDifficulty,
    GaitResult,
    ReachResult,
    RunRecord,
    Shipped,
    StabilityResult,
    SteppingRow,
    Training,
    WindowResult,
)


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
                check_data(SteppingRow, row, where)
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
    """Check what the types of time_window.json cannot say: a run in which robots arrived has all three figures.

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
    """Check that a row with a cost also has the speed.

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
    "difficulty": (DifficultyResult, check_usage),
    "exported": (ExportedDifficulty, _nothing),
    "training": (Training, _nothing),
    "record": (RunRecord, _nothing),
    "shipped": (Shipped, _nothing),
    "reach": (ReachResult, check_reach),
    "energy": (EnergyResult, check_energy),
    "gait": (GaitResult, check_gaits),
    "stability": (StabilityResult, check_stability),
    "time_window": (WindowResult, check_window),
}
"""Type and further check of each format. Results call themselves by these names, in `protocol.name`."""
