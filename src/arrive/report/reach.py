"""Where and by when a policy arrives, in tables and words, for the terminal, the card and the report."""

from collections.abc import Sequence
from typing import Any

from arrive.terrain import get_family
from arrive.terrain.ground import Ground

Table = tuple[list[str], list[list[str]]]
"""Head and rows."""


def ground_words(name: str, entry: dict[str, Any]) -> str:
    """The terrain of one entry of reach.json, such as "gap 0.4 m"."""
    return f"{name} {Ground(get_family(name), entry['value']).amount}".strip()


def distance_table(entry: dict[str, Any]) -> Table:
    """Success by distance, a column per time given; failures are those of the time nearest to the protocol's."""
    times = list(dict.fromkeys(row["time_s"] for row in entry["distances"]))
    told = entry["waiting"]["time_s"]
    rows = []
    for distance in dict.fromkeys(row["distance_m"] for row in entry["distances"]):
        mine = {row["time_s"]: row for row in entry["distances"] if row["distance_m"] == distance}
        stood = next((row["stood_at_m"] for row in mine.values() if "stood_at_m" in row), None)
        place = f"{distance:g} m" + ("" if stood is None else f" (next valid place: {stood:.1f} m)")
        rows.append([place, *(share_words(mine[time]) for time in times), failure_words(mine[told])])
    return ["distance", *(f"in {time:g} s [%]" for time in times), f"failures in {told:g} s"], rows


def direction_table(entry: dict[str, Any]) -> Table:
    """Success by direction."""
    told = entry["waiting"]["time_s"]
    rows = [[f"{row['direction_deg']:g}°", share_words(row), failure_words(row)] for row in entry["directions"]]
    return ["direction", f"in {told:g} s [%]", "failures"], rows


def share_words(row: dict[str, Any]) -> str:
    """A success rate with its 95 % interval, in percent, such as "97.5 (94.3-98.9)"."""
    low, high = row["interval"]
    return f"{100 * row['success']:.1f} ({100 * low:.1f}-{100 * high:.1f})"


def failure_words(row: dict[str, Any]) -> str:
    """How many episodes failed by which cause."""
    return ", ".join(f"{cause} {count}" for cause, count in sorted(row["failures"].items()))


def waiting_words(waiting: dict[str, Any]) -> str:
    """Whether robots that arrived stayed."""
    if not waiting["arrived"]:
        return f"nobody arrived within {waiting['time_s']:g} s, so nobody waited"
    low, high = waiting["interval"]
    failures = failure_words(waiting)
    return (
        f"{waiting['stayed']} of {waiting['arrived']} robots that arrived within {waiting['time_s']:g} s still stood "
        f"there {waiting['wait_s']:g} s later: {waiting['share']:.1%} ({100 * low:.1f}-{100 * high:.1f})"
        + (f"; the others: {failures}" if failures else "")
    )


def protocol_words(difficulty: dict[str, Any] | None, name: str, entry: dict[str, Any]) -> str:
    """The result of the protocol of maximum difficulty at the same value, to compare; empty if there is none."""
    if difficulty is None:
        return ""
    levels: Sequence[dict[str, Any]] = (difficulty.get("families", {}).get(name) or {}).get("levels", ())
    same = [level for level in levels if abs(level["value"] - entry["value"]) < 1e-6]
    if not same:
        return ""
    trial = difficulty["protocol"]["trial"]
    task = f"{trial['target'][0]:g} m ahead, {trial['duration_s']:g} s"
    return f"By the paper's protocol ({task}): {share_words(same[0])} %."
