"""Small actuator networks that behave like a PD motor with a lag, for tests."""

import numpy as np

from arrive.actuation.network import ActuatorNetwork

PERIOD_S = 0.005


def lstm(units: int = 4, layers: int = 2, seed: int = 0, **changes) -> ActuatorNetwork:
    """Random weights, with one path from the error to the torque that is far stronger than the rest."""
    rng = np.random.default_rng(seed)
    weights, size = {}, 2
    for layer in range(layers):
        entries = rng.normal(0, 0.1, (4 * units, size))
        entries[2 * units] = 0.0
        entries[2 * units, 0] = 1.0  # the candidate of the first unit follows the error
        if layer == 0:
            entries[2 * units, 1] = -0.05
        weights[f"lstm.weight_ih_l{layer}"] = entries
        weights[f"lstm.weight_hh_l{layer}"] = rng.normal(0, 0.1, (4 * units, units))
        weights[f"lstm.bias_ih_l{layer}"] = rng.normal(0, 0.1, 4 * units)
        weights[f"lstm.bias_hh_l{layer}"] = rng.normal(0, 0.1, 4 * units)
        size = units
    weights["linear.weight"] = np.eye(1, units) * 10.0
    weights["linear.bias"] = np.zeros(1)
    return network("lstm", weights, **changes)


def taps(units: tuple[int, ...] = (5, 3), seed: int = 0, **changes) -> ActuatorNetwork:
    """Three taps now, 10 and 20 ms ago; the first unit of each layer carries error and velocity."""
    rng = np.random.default_rng(seed)
    weights, size = {}, 6
    for layer, count in enumerate((*units, 1)):
        matrix = rng.normal(0, 0.02, (count, size))
        matrix[0, 0] = 0.5
        if layer == 0:
            matrix[0] = (0.2, 0.2, 0.1, -0.02, -0.02, -0.01)
        weights[f"layers.{layer}.weight"], weights[f"layers.{layer}.bias"] = matrix, rng.normal(0, 0.01, count)
        size = count
    return network("taps", weights, **{"taps_s": (0.0, 0.01, 0.02)} | changes)


def network(architecture: str, weights: dict[str, np.ndarray], **changes) -> ActuatorNetwork:
    values = {"period_s": PERIOD_S, "error_scale": 2.0, "velocity_scale": 0.25, "torque_scale": 40.0} | changes
    if architecture == "taps":
        values |= {"torque_scale": changes.get("torque_scale", 800.0)}
    return ActuatorNetwork(architecture, {name: a.astype(np.float32) for name, a in weights.items()}, **values)
