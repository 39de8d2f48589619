"""Gaits: duty factors, strides and phases of the feet, from their contacts over time."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

TOGETHER = 0.125
"""Feet whose phases differ by at most this share of a stride step together: half of a walk's quarter."""
STEADY = 0.15
"""A gait whose phases spread by more than this has no name [strides]."""
BOUNCE_S = 0.04
"""A contact that is lost for no longer than this does not end a stance [s]."""
LEAST_STRIDES = 2
"""Whole strides of each foot without which nothing is said."""
NAMES = {
    "trot": "both diagonal pairs step together, half a stride apart",
    "pace": "both pairs of one side step together, half a stride apart",
    "bound": "the fore pair and the hind pair step together, apart from each other",
    "pronk": "all feet step together",
    "walk": "four feet step one by one, and each stands for more than half of the stride",
    "tripod": "six feet step in two groups of three, half a stride apart",
    "three-phased": "the feet step in three groups: of four, one pair steps together between two single feet",
    "none": f"none of these, or phases that spread by more than {STEADY:g} strides",
}
"""Names with their meanings; feet step together whose phases differ by at most `TOGETHER` strides."""


@dataclass(frozen=True, eq=False)
class Footfalls:
    """The gait of one robot; phases and duty factors are shares of a stride."""

    duty: np.ndarray
    """(feet,) share of the stride in which each foot stands."""
    frequency_hz: float
    """Strides per second, the mean of all feet."""
    phase: np.ndarray
    """(feet,) mean phase of touch-down after that of the reference foot, 0 to 1."""
    spread: np.ndarray
    """(feet,) circular standard deviation of that phase over the strides."""


def footfalls(contact: np.ndarray, dt: float, reference: int = 0) -> Footfalls | None:
    """Find strides and phases; contacts lost for up to `BOUNCE_S` end no stance.

    Args:
        contact: (steps, feet) bool, whether each foot stands.
        dt: time between steps [s].
        reference: foot whose touch-downs begin the strides.

    Returns:
        None where some foot makes fewer than `LEAST_STRIDES` strides.
    """
    stands = steady(contact, dt)
    touchdowns = [np.flatnonzero(stands[1:, foot] & ~stands[:-1, foot]) + 1 for foot in range(stands.shape[1])]
    if min(map(len, touchdowns)) <= LEAST_STRIDES:
        return None
    spans = [(times[0], times[-1]) for times in touchdowns]
    duty = [stands[first:last, foot].mean() for foot, (first, last) in enumerate(spans)]
    rates = [(len(times) - 1) / ((times[-1] - times[0]) * dt) for times in touchdowns]
    phases = [phases_after(touchdowns[reference], times) for times in touchdowns]
    if not all(map(len, phases)):
        return None
    means, spreads = zip(*(circular(values) for values in phases), strict=True)
    return Footfalls(np.array(duty), float(np.mean(rates)), np.array(means), np.array(spreads))


def steady(contact: np.ndarray, dt: float) -> np.ndarray:
    """(steps, feet) contacts without gaps of up to `BOUNCE_S`."""
    stands = contact.astype(bool).copy()
    longest = round(BOUNCE_S / dt)
    for foot in stands.T:
        edges = np.flatnonzero(np.diff(foot.astype(int)))
        for before, after in itertools.pairwise(edges):
            if foot[before] and after - before <= longest:
                foot[before : after + 1] = True
    return stands


def phases_after(reference: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Phases of touch-downs within the reference foot's strides, each 0 to 1.

    Args:
        reference, times: ascending steps at which the two feet touch down.
    """
    stride = np.searchsorted(reference, times, side="right") - 1
    inside = (stride >= 0) & (stride < len(reference) - 1)
    first, last = reference[stride[inside]], reference[stride[inside] + 1]
    return (times[inside] - first) / (last - first)


def circular(phases: np.ndarray) -> tuple[float, float]:
    """Circular mean, 0 to 1, and circular standard deviation of phases [strides]."""
    resultant = np.exp(2j * np.pi * phases).mean()
    length = min(abs(resultant), 1.0)
    spread = math.sqrt(-2.0 * math.log(length)) / (2.0 * math.pi) if length > 0.0 else math.inf
    return float(np.angle(resultant) / (2.0 * np.pi) % 1.0), spread


def apart(first: float, second: float) -> float:
    """How far two phases are apart on the circle, 0 to 0.5."""
    difference = abs(first - second) % 1.0
    return min(difference, 1.0 - difference)


def groups_of(phase: np.ndarray) -> list[list[int]]:
    """Feet that step together, in the order of their phases: neighbours on the circle within `TOGETHER` are joined."""
    order = np.argsort(phase, kind="stable").tolist()
    groups = [[order[0]]]
    for before, foot in itertools.pairwise(order):
        if apart(phase[before], phase[foot]) <= TOGETHER:
            groups[-1].append(foot)
        else:
            groups.append([foot])
    if len(groups) > 1 and apart(phase[order[-1]], phase[order[0]]) <= TOGETHER:
        groups[0] = groups.pop() + groups[0]
    return groups


def gait_name(falls: Footfalls, corners: np.ndarray) -> str:
    """The gait's name by `NAMES`.

    Args:
        corners: (feet, 2) places of the feet under the standing robot, forward and left of the base [m].
    """
    if float(falls.spread.max()) > STEADY:
        return "none"
    groups = groups_of(falls.phase)
    if len(groups) == 1:
        return "pronk"
    count = len(falls.phase)
    if count == 4 and sorted(map(len, groups)) == [2, 2]:
        return _pair_name(falls.phase, groups, corners)
    if count == 6 and sorted(map(len, groups)) == [3, 3]:
        return "tripod" if _opposed(falls.phase, groups) else "none"
    if count == 4 and len(groups) == 4:
        return "walk" if float(falls.duty.min()) > 0.5 else "none"
    return "three-phased" if len(groups) == 3 else "none"


def _pair_name(phase: np.ndarray, groups: list[list[int]], corners: np.ndarray) -> str:
    """Of a four-footed robot whose feet step in two pairs."""
    fore, left = corners[:, 0] > 0.0, corners[:, 1] > 0.0
    first, second = groups[0]
    if fore[first] == fore[second]:
        return "bound"
    name = "pace" if left[first] == left[second] else "trot"
    return name if _opposed(phase, groups) else "none"


def _opposed(phase: np.ndarray, groups: list[list[int]]) -> bool:
    """Whether two groups are half a stride apart, within `TOGETHER`."""
    first, second = (circular(phase[group])[0] for group in groups)
    return apart(first, second) >= 0.5 - TOGETHER


def hildebrand(falls: Footfalls, corners: np.ndarray) -> tuple[float, float] | None:
    """Hildebrand's axes of a four-footed gait (M. Hildebrand, 1965, Science 150, 701).

    Returns:
        Share of the stride in which a hind foot stands, and share by which the fore foot follows the hind foot of its
        side, means of both sides; None of robots without one foot in each corner.
    """
    fore, left = corners[:, 0] > 0.0, corners[:, 1] > 0.0
    places = {(bool(f), bool(side)): foot for foot, (f, side) in enumerate(zip(fore, left, strict=True))}
    if len(falls.phase) != 4 or len(places) != 4:
        return None
    lags = [(falls.phase[places[True, side]] - falls.phase[places[False, side]]) % 1.0 for side in (True, False)]
    return float(falls.duty[~fore].mean()), circular(np.array(lags))[0]
