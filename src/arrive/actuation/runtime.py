"""Actuator networks in NumPy, for all joints at once and without allocating.

Measured against PyTorch on one core, NumPy's float32 tanh is six times faster and the rest as fast. Joints lie in
blocks of columns: a layer is one stacked matrix product over all blocks, each small enough for OpenBLAS to keep it on
the calling thread. Its waiting threads would take the cores that physics needs.
"""

from typing import Protocol

import numpy as np

from arrive.actuation.network import ActuatorNetwork

BLAS_THREADS_FROM = 262_144
"""Multiplications from which OpenBLAS may use more than one thread."""


class NetworkRuntime(Protocol):
    """A network with the state of every joint."""

    def step(self, error_rad: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Torque of (num_joints,) joints for the next period [N m]: a view, overwritten by the next call."""

    def reset(self, joints: np.ndarray) -> None:
        """Forget what these joints did, by index."""

    def state(self) -> dict[str, np.ndarray]:
        """A copy of everything that is remembered; each array has the joints in front."""

    def load_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on exactly from a `state`."""


def make_runtime(network: ActuatorNetwork, num_joints: int) -> NetworkRuntime:
    """The network for this many joints, each with a state of its own."""
    return (LstmRuntime if network.architecture == "lstm" else TapsRuntime)(network, num_joints)


class LstmRuntime:
    """LSTM layers and a linear one.

    The rows of a block are [error, velocity, 1, h_0, 1, h_1, ..., 1], so that what a layer reads - its input, a one for
    its bias and its own hidden state - is one slice, and what it computes is written to where it is read next.
    """

    def __init__(self, network: ActuatorNetwork, num_joints: int):
        """Start with states of zero."""
        matrices = lstm_matrices(network)
        self._blocks = Blocks(num_joints, max(matrix.size for matrix in matrices))
        self._units, self._matrices, self._output = network.units, matrices[:-1], matrices[-1]
        self._rows = self._blocks.zeros(2 + len(self._units) + sum(self._units) + 1)
        self._inputs, self._hidden, start = [], [], 0
        for size, units in zip((2, *self._units), self._units, strict=False):
            self._rows[:, start + size] = 1.0
            self._inputs.append(self._rows[:, start : start + size + 1 + units])
            self._hidden.append(self._rows[:, start + size + 1 : start + size + 1 + units])
            start += size + 1
        self._rows[:, -1] = 1.0
        self._last = self._rows[:, start:]
        self._cells = [self._blocks.zeros(units) for units in self._units]
        self._gates = [self._blocks.zeros(4 * units) for units in self._units]
        self._torque = self._blocks.zeros(1)

    def step(self, error_rad: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        self._blocks.fill(self._rows[:, 0], error_rad)
        self._blocks.fill(self._rows[:, 1], velocity)
        for layer, units in enumerate(self._units):
            gates, cell = self._gates[layer], self._cells[layer]
            np.matmul(self._matrices[layer], self._inputs[layer], out=gates)
            np.tanh(gates, out=gates)
            sigmoids = gates[:, : 3 * units]  # sigmoid(x) = (1 + tanh(x / 2)) / 2; the inner half is in the matrix
            sigmoids *= 0.5
            sigmoids += 0.5
            entry, forget, exit_, candidate = (gates[:, i * units : (i + 1) * units] for i in range(4))
            cell *= forget
            candidate *= entry
            cell += candidate
            np.tanh(cell, out=candidate)
            np.multiply(exit_, candidate, out=self._hidden[layer])
        np.matmul(self._output, self._last, out=self._torque)
        return self._blocks.joints(self._torque)

    def reset(self, joints: np.ndarray) -> None:
        for array in (*self._hidden, *self._cells):
            self._blocks.put(array, joints, 0.0)

    def state(self) -> dict[str, np.ndarray]:
        parts = {"hidden": self._hidden, "cell": self._cells}
        return {name: np.hstack([self._blocks.get(array) for array in arrays]) for name, arrays in parts.items()}

    def load_state(self, state: dict[str, np.ndarray]) -> None:
        starts = np.cumsum(self._units)[:-1]
        for name, arrays in (("hidden", self._hidden), ("cell", self._cells)):
            for array, values in zip(arrays, np.split(state[name], starts, axis=1), strict=True):
                self._blocks.put(array, self._blocks.everyone, values)


class TapsRuntime:
    """Softsign layers on errors and velocities of now and of before.

    A block keeps all errors and velocities up to the longest delay; delays without a tap have a weight of zero.
    """

    def __init__(self, network: ActuatorNetwork, num_joints: int):
        """Start as if there had never been an error or a velocity."""
        self._matrices = taps_matrices(network)
        self._blocks = Blocks(num_joints, max(matrix.size for matrix in self._matrices))
        self._depth = max(network.tap_steps) + 1
        self._layers = [self._blocks.zeros(matrix.shape[1]) for matrix in self._matrices]
        for layer in self._layers:
            layer[:, -1] = 1.0
        past = self._layers[0][:, :-1]
        self._history = past.reshape(len(past), 2, self._depth, -1)  # splits an axis, so it is a view
        self._magnitudes = [np.empty_like(layer[:, :-1]) for layer in self._layers[1:]]
        self._torque = self._blocks.zeros(1)

    def step(self, error_rad: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        self._history[:, :, 1:] = self._history[:, :, :-1]
        self._blocks.fill(self._history[:, 0, 0], error_rad)
        self._blocks.fill(self._history[:, 1, 0], velocity)
        hidden = zip(self._matrices[:-1], self._layers, self._layers[1:], self._magnitudes, strict=False)
        for matrix, before, after, magnitude in hidden:
            values = after[:, :-1]
            np.matmul(matrix, before, out=values)
            np.abs(values, out=magnitude)
            magnitude += 1.0
            values /= magnitude
        np.matmul(self._matrices[-1], self._layers[-1], out=self._torque)
        return self._blocks.joints(self._torque)

    def reset(self, joints: np.ndarray) -> None:
        self._blocks.put(self._history, joints, 0.0)

    def state(self) -> dict[str, np.ndarray]:
        return {"history": self._blocks.get(self._history)}

    def load_state(self, state: dict[str, np.ndarray]) -> None:
        self._blocks.put(self._history, self._blocks.everyone, state["history"])


class Blocks:
    """Joints as columns of equally large blocks; the last block may have unused columns."""

    def __init__(self, num_joints: int, largest_matrix: int):
        """Choose the columns of a block so that a product with the largest matrix stays on one thread."""
        self.everyone = np.arange(num_joints)
        self.lanes = max(min(BLAS_THREADS_FROM // largest_matrix // 16 * 16, num_joints), 1)
        self._count = -(-num_joints // self.lanes)
        self._staged = np.zeros(self._count * self.lanes, dtype=np.float32)

    def zeros(self, rows: int) -> np.ndarray:
        """(blocks, rows, lanes) float32."""
        return np.zeros((self._count, rows, self.lanes), dtype=np.float32)

    def fill(self, row: np.ndarray, values: np.ndarray) -> None:
        """Write (num_joints,) values into a (blocks, lanes) row."""
        self._staged[: len(self.everyone)] = values
        row[:] = self._staged.reshape(row.shape)

    def joints(self, array: np.ndarray) -> np.ndarray:
        """(num_joints,) the single row of an array of `zeros(1)`, as a view."""
        return array.reshape(-1)[: len(self.everyone)]

    def get(self, array: np.ndarray) -> np.ndarray:
        """(num_joints, ...) a copy of a (blocks, ..., lanes) array."""
        return array[self.everyone // self.lanes, ..., self.everyone % self.lanes]

    def put(self, array: np.ndarray, joints: np.ndarray, values: np.ndarray | float) -> None:
        """Write the values of some joints into a (blocks, ..., lanes) array."""
        array[joints // self.lanes, ..., joints % self.lanes] = values


def lstm_matrices(network: ActuatorNetwork) -> list[np.ndarray]:
    """One matrix per layer on [input, 1, own hidden state], and the linear layer's on [hidden state, 1].

    Gates are in the order input, forget, output, candidate; the first three have half of PyTorch's weights, because
    their sigmoid is computed by tanh. Scales of inputs and torque are in the matrices.
    """
    weights = {name: array.astype(np.float64) for name, array in network.weights.items()}
    matrices = []
    for layer, units in enumerate(network.units):
        entries = weights[f"lstm.weight_ih_l{layer}"]
        if layer == 0:
            entries = entries * [network.error_scale, network.velocity_scale]
        bias = weights[f"lstm.bias_ih_l{layer}"] + weights[f"lstm.bias_hh_l{layer}"]
        matrix = np.hstack([entries, bias[:, None], weights[f"lstm.weight_hh_l{layer}"]])
        entry, forget, candidate, exit_ = matrix.reshape(4, units, -1)
        matrices.append(np.vstack([entry / 2, forget / 2, exit_ / 2, candidate]))
    matrices.append(network.torque_scale * np.hstack([weights["linear.weight"], weights["linear.bias"][:, None]]))
    return [np.ascontiguousarray(matrix, dtype=np.float32) for matrix in matrices]


def taps_matrices(network: ActuatorNetwork) -> list[np.ndarray]:
    """One matrix per layer on [input, 1]; the first layer's input has every delay up to the longest."""
    weights = {name: array.astype(np.float64) for name, array in network.weights.items()}
    taps, depth = list(network.tap_steps), max(network.tap_steps) + 1
    first = weights["layers.0.weight"]
    spread = np.zeros((len(first), 2, depth))
    spread[:, 0, taps] = network.error_scale * first[:, : len(taps)]
    spread[:, 1, taps] = network.velocity_scale * first[:, len(taps) :]
    weights["layers.0.weight"] = spread.reshape(len(first), -1)
    count = len(network.units) + 1
    matrices = [np.hstack([weights[f"layers.{i}.weight"], weights[f"layers.{i}.bias"][:, None]]) for i in range(count)]
    matrices[-1] *= network.torque_scale
    return [np.ascontiguousarray(matrix, dtype=np.float32) for matrix in matrices]
