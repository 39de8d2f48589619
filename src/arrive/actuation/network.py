"""A small neural network that models a drive: its weights, their meaning, and checks before they are used."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from arrive.errors import ArriveError

Architecture = Literal["lstm", "taps"]
MAX_UNITS, MAX_LAYERS, MAX_DELAY = 256, 8, 64
"""Larger networks are no drive's: units per layer, layers, and delay of a tap in periods."""


@dataclass(frozen=True)
class ActuatorNetwork:
    """The torque of one joint from position errors and velocities; the same network serves all joints.

    `lstm`: (error, velocity) through LSTM layers, whose state is kept from step to step, and one linear layer, as
    legged_gym runs it for ANYmal C (two layers of eight units). `taps`: errors and velocities, each at the delays
    `taps_s`, through layers of softsign units and a linear one (Hwangbo et al. 2019: now, 10 ms and 20 ms ago, three
    layers of 32 units). Errors come before velocities, in the order of the taps. Before a reset there was no error and
    no velocity.

    Raises:
        ArriveError: weights and description do not fit together, or are no numbers.
    """

    architecture: Architecture
    weights: Mapping[str, np.ndarray]
    """float32 arrays by PyTorch's names: lstm.weight_ih_l0, ..., linear.bias; or layers.0.weight, layers.0.bias, ..."""
    period_s: float
    """Time between two calls [s]."""
    error_scale: float
    """The network receives position errors times this [1/rad]."""
    velocity_scale: float
    """It receives velocities times this [s/rad]."""
    torque_scale: float
    """Its output times this is the torque [N m]."""
    taps_s: tuple[float, ...] = ()
    """Delays of the inputs of `taps`, multiples of the period [s]."""
    data: str = ""
    """Description of the training data."""
    error_nm: float | None = None
    """RMS error on trajectories held out from training [N m]; None if it was not measured."""

    def __post_init__(self) -> None:
        for name in ("period_s", "error_scale", "velocity_scale", "torque_scale"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArriveError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if self.error_nm is not None and not 0.0 <= self.error_nm < math.inf:
            raise ArriveError(f"error_nm must be 0 or more and finite, not {self.error_nm}")
        self._check_taps()
        self._check_weights()

    @property
    def units(self) -> tuple[int, ...]:
        """Units of each hidden layer."""
        if self.architecture == "lstm":
            return tuple(self.weights[f"lstm.weight_hh_l{layer}"].shape[1] for layer in range(self._num_layers()))
        return tuple(self.weights[f"layers.{layer}.weight"].shape[0] for layer in range(self._num_layers() - 1))

    @property
    def tap_steps(self) -> tuple[int, ...]:
        """Delays of the taps in periods."""
        return tuple(round(tap / self.period_s) for tap in self.taps_s)

    def _num_layers(self) -> int:
        beginning = "lstm.weight_hh_l" if self.architecture == "lstm" else "layers."
        return sum(name.startswith(beginning) and not name.endswith("bias") for name in self.weights)

    def _check_taps(self) -> None:
        if (self.architecture == "taps") != bool(self.taps_s):
            raise ArriveError("only the architecture `taps` has taps_s")
        for tap in self.taps_s:
            steps = tap / self.period_s if math.isfinite(tap) else -1.0
            if not 0.0 <= steps <= MAX_DELAY or abs(steps - round(steps)) > 1e-6:
                raise ArriveError(
                    f"a tap of {tap} s is no multiple from 0 to {MAX_DELAY} of the period of {self.period_s} s"
                )

    def _check_weights(self) -> None:
        layers = self._num_layers()
        if not 1 <= layers <= MAX_LAYERS:
            raise ArriveError(f"a network `{self.architecture}` has 1 to {MAX_LAYERS} layers, not {layers}")
        expected = dict(_lstm_shapes(self.weights, layers) if self.architecture == "lstm" else self._taps_shapes())
        for name in sorted(expected.keys() ^ self.weights.keys()):
            raise ArriveError(
                f"{'no' if name in expected else 'unknown'} array {name} in a network `{self.architecture}`"
            )
        for name, shape in expected.items():
            array = self.weights[name]
            if array.dtype != np.float32 or array.shape != shape:
                raise ArriveError(f"{name} is {array.dtype} {array.shape}, where float32 {shape} is needed")
            if not np.isfinite(array).all():
                raise ArriveError(f"{name} has values that are no finite numbers")

    def _taps_shapes(self) -> Iterator[tuple[str, tuple[int, ...]]]:
        size = 2 * len(self.taps_s)
        last = self._num_layers() - 1
        for layer in range(last + 1):
            units = 1 if layer == last else _rows(self.weights, f"layers.{layer}.weight")
            yield f"layers.{layer}.weight", (units, size)
            yield f"layers.{layer}.bias", (units,)
            size = units


def _lstm_shapes(weights: Mapping[str, np.ndarray], layers: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    size = 2
    for layer in range(layers):
        units = _rows(weights, f"lstm.weight_hh_l{layer}") // 4
        yield f"lstm.weight_ih_l{layer}", (4 * units, size)
        yield f"lstm.weight_hh_l{layer}", (4 * units, units)
        yield f"lstm.bias_ih_l{layer}", (4 * units,)
        yield f"lstm.bias_hh_l{layer}", (4 * units,)
        size = units
    yield "linear.weight", (1, size)
    yield "linear.bias", (1,)


def _rows(weights: Mapping[str, np.ndarray], name: str) -> int:
    """Rows of a matrix, of which a layer has a sensible number."""
    if name not in weights:
        raise ArriveError(f"no array {name}")
    array = weights[name]
    if array.ndim != 2 or not 1 <= len(array) <= 4 * MAX_UNITS:
        raise ArriveError(f"{name} is {array.shape}, where a matrix of 1 to {4 * MAX_UNITS} rows is needed")
    return len(array)
