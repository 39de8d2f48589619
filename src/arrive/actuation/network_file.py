"""Actuator networks as safetensors files: arrays and a description in words and numbers, nothing that can run."""

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from arrive.actuation.network import ActuatorNetwork, Architecture
from arrive.errors import ArriveError, unknown_name
from arrive.files import check_readable, write_bytes

FORMAT = "arrive-actuator-1"
UNITS = {"position_error": "rad", "velocity": "rad/s", "torque": "N m", "time": "s"}
"""The only units that a file may have; it says them so that one with others is noticed."""
DIGEST = "sha256"
"""Of the rest of the metadata and of the arrays."""
NUMBERS = ("period_s", "error_scale", "velocity_scale", "torque_scale")


def write_network(path: Path, network: ActuatorNetwork) -> None:
    """Write a network with all that running it takes.

    Raises:
        ArriveError: the file cannot be written.
    """
    description = {
        "format": FORMAT,
        "architecture": network.architecture,
        "hidden_units": network.units,
        "units": UNITS,
        "taps_s": network.taps_s,
        "data": network.data,
        "error_nm": network.error_nm,
        **{name: getattr(network, name) for name in NUMBERS},
    }
    text = {name: json.dumps(value) for name, value in description.items()}
    text[DIGEST] = json.dumps(_digest(text, network.weights))
    write_bytes(path, save(dict(network.weights), text))


def read_network(path: Path, period_s: float | None = None) -> ActuatorNetwork:
    """Read a network; nothing from the file is executed.

    Args:
        period_s: how often it is going to be called; None where it is only looked at [s].

    Raises:
        ArriveError: no such file, damaged, foreign, of another shape, period or unit, or with values that are no
            numbers. The message names the file.
    """
    try:
        network = _network(*_read(path))
    except ArriveError as error:
        raise ArriveError(f"{path}: {error}") from error
    if period_s is not None and not math.isclose(period_s, network.period_s, rel_tol=1e-6):
        raise ArriveError(
            f"{path} gives a torque every {network.period_s:g} s and the physics step is {period_s:g} s: "
            f"set physics.timestep_s={network.period_s:g}, or fit a network with that period"
        )
    return network


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Description and arrays of a file."""
    if not path.is_file():
        raise ArriveError("no such file; `arrive actuator fit` makes one")
    check_readable(path)
    try:
        with safe_open(path, framework="numpy") as file:
            text = file.metadata() or {}
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, it is no dict
    except (SafetensorError, OSError, TypeError, ValueError, AttributeError) as error:
        raise ArriveError(f"this is no safetensors file, or a damaged one ({error})") from error
    try:
        description = {name: json.loads(value) for name, value in text.items()}
    except (ValueError, RecursionError) as error:
        raise ArriveError("its metadata are not those of an actuator network") from error
    seal = description.pop(DIGEST, None)
    description["sound"] = seal == _digest({name: value for name, value in text.items() if name != DIGEST}, weights)
    return description, weights


def _digest(text: Mapping[str, str], weights: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of a description and arrays, in hexadecimal."""
    shapes = {name: [str(array.dtype), array.shape] for name, array in weights.items()}
    digest = hashlib.sha256(json.dumps([dict(text), shapes], sort_keys=True).encode())
    for name in sorted(weights):
        digest.update(np.ascontiguousarray(weights[name]).tobytes())
    return digest.hexdigest()


def _network(description: dict[str, Any], weights: dict[str, np.ndarray]) -> ActuatorNetwork:
    needed = ("format", "architecture", "units", "taps_s", "hidden_units", *NUMBERS)
    missing = [name for name in needed if name not in description]
    if missing or description["format"] != FORMAT:
        lacks = f"; it lacks {', '.join(missing)}" if missing else ""
        raise ArriveError(f"this is no actuator network of the format {FORMAT}{lacks}")
    if description["units"] != UNITS:
        raise ArriveError(f"its units are {description['units']}, where {UNITS} are needed")
    if description["architecture"] not in get_args(Architecture):
        raise unknown_name("architecture", str(description["architecture"]), get_args(Architecture))
    try:
        network = ActuatorNetwork(
            description["architecture"],
            weights,
            **{name: float(description[name]) for name in NUMBERS},
            taps_s=tuple(float(tap) for tap in description["taps_s"]),
            data=str(description.get("data", "")),
            error_nm=None if description.get("error_nm") is None else float(description["error_nm"]),
        )
    except (TypeError, ValueError) as error:
        raise ArriveError(f"its metadata have no number where one is needed ({error})") from error
    if list(network.units) != description["hidden_units"]:
        raise ArriveError(f"it says {description['hidden_units']} hidden units and has {list(network.units)}")
    if not description["sound"]:
        raise ArriveError("it was changed since it was written, or is of an older version: fit or import it again")
    return network
