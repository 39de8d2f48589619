"""Targets and loads that show a drive in all that a legged robot asks of it."""

from collections.abc import Callable

import numpy as np

from arrive.actuation.series_elastic import Load

CONTROL_S = 0.02
"""How long a policy holds a target [s]."""
SEGMENT_S = (1.0, 3.0)
"""Each kind of motion lasts as long as is drawn between these [s]."""

Targets = Callable[[np.random.Generator, np.ndarray], np.ndarray]


def _chirp(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """A sine from 0.3 Hz to 3 to 20 Hz, less wide where it is fast."""
    low, high = 0.3, rng.uniform(3.0, 20.0)
    rate = np.log(high / low) / time[-1]
    phase = 2 * np.pi * low * np.expm1(rate * time) / rate
    return rng.uniform(0.2, 0.8) * np.exp(-0.5 * rate * time) * np.sin(phase)


def _sines(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Three sines of 0.5 to 8 Hz, as a gait has them."""
    frequency = rng.uniform(0.5, 8.0, 3)
    width = rng.uniform(0.1, 0.5, 3) / np.sqrt(frequency)
    return (width * np.sin(2 * np.pi * frequency * time[:, None] + rng.uniform(0, 2 * np.pi, 3))).sum(1)


def _steps(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Jumps of up to 1 rad, 0.1 to 0.6 s apart."""
    starts = np.cumsum(rng.uniform(0.1, 0.6, 40))
    return rng.uniform(-0.5, 0.5, 41)[np.searchsorted(starts, time)]


def _policy(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Targets as of an exploring policy: a new random one every 20 ms, around a slow motion."""
    index = (time / CONTROL_S).astype(int)
    slow = 0.3 * np.sin(2 * np.pi * rng.uniform(0.3, 3.0) * time[:, None] + rng.uniform(0, 6, 1))[:, 0]
    return slow[np.searchsorted(index, index)] + rng.normal(0, rng.uniform(0.05, 0.4), index[-1] + 1)[index]


KINDS: tuple[Targets, ...] = (_chirp, _sines, _steps, _policy)


def excite(rng: np.random.Generator, steps: int, joints: int, period_s: float) -> np.ndarray:
    """(steps, joints) targets: chirps, gaits, jumps and a policy's noise one after the other, around zero [rad]."""
    targets = np.zeros((steps, joints))
    for joint in range(joints):
        start = 0
        while start < steps:
            length = max(round(rng.uniform(*SEGMENT_S) / period_s), 2)
            time = np.arange(length) * period_s
            values = KINDS[rng.integers(len(KINDS))](rng, time)[: steps - start]
            targets[start : start + length, joint] = values
            start += length
    return targets


def random_load(rng: np.random.Generator, steps: int, joints: int, period_s: float) -> Load:
    """Inertias from a shank's to a robot's, log-uniform; half of the joints are pushed too, by up to 60 N m at 2 Hz."""
    inertia = np.exp(rng.uniform(np.log(0.05), np.log(2.0), joints))
    knots = np.arange(0.0, steps * period_s + 1.0, 0.5)
    time = np.arange(steps) * period_s
    pushing = rng.random(joints) < 0.5
    push = [np.interp(time, knots, rng.uniform(-60.0, 60.0, len(knots))) * on for on in pushing]
    return Load(inertia, rng.uniform(0.0, 20.0, joints), np.where(pushing, 5.0, 0.3), np.stack(push, axis=1))
