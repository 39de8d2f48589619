"""Networks of others, brought into the form of this software."""

from pathlib import Path

import numpy as np

from arrive.actuation.network import ActuatorNetwork
from arrive.arrays import as_numbers, read_arrays
from arrive.errors import ArriveError


def read_lstm_arrays(path: Path, period_s: float, data: str) -> ActuatorNetwork:
    """An LSTM from plain arrays (NPZ) under PyTorch's names, `lstm.*` and `linear.*`, with `in_scale` and `out_scale`.

    That is the content of legged_gym's actuator network; nothing from the file is executed.

    Raises:
        ArriveError: it cannot be read, or lacks an array, or has one of another shape.
    """
    arrays = {name: as_numbers(path, name, value, np.float32) for name, value in read_arrays(path).items()}
    scales = [arrays.pop(name, np.empty(0)).ravel() for name in ("in_scale", "out_scale")]
    if [len(scale) for scale in scales] != [2, 1]:
        raise ArriveError(f"{path}: in_scale must have two values, for error and velocity, and out_scale one")
    error, velocity, torque = (float(value) for scale in scales for value in scale)
    try:
        return ActuatorNetwork("lstm", arrays, period_s, error, velocity, torque, data=data)
    except ArriveError as problem:
        raise ArriveError(f"{path}: {problem}") from problem
