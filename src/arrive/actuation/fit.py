"""Trains an actuator network from logged joints."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from arrive.actuation.logs import Trajectory
from arrive.actuation.modules import LstmModule, TapsModule
from arrive.actuation.network import ActuatorNetwork, Architecture
from arrive.actuation.runtime import make_runtime
from arrive.errors import ArriveError

WINDOW_S, WARM_UP_S = 1.0, 0.2
"""Training sees windows of a trajectory, from rest; the first part of each is not scored [s]."""
MIN_TRAJECTORIES = 5
"""From this many on, whole trajectories are held out; of fewer, the ends."""


@dataclass(frozen=True)
class FitConfig:
    """How a network is trained."""

    architecture: Architecture = "lstm"
    """`lstm`: legged_gym's kind; `taps`: delayed inputs and softsign units, Hwangbo et al. 2019."""
    units: tuple[int, ...] = ()
    """Units of each hidden layer, equal for `lstm`; by default 8 8 for `lstm` and 32 32 32 for `taps`."""
    taps_s: tuple[float, ...] = (0.0, 0.01, 0.02)
    """Delays of the inputs of `taps` [s]."""
    epochs: int = 150
    """At most so many passes over the training data."""
    patience: int = 20
    """Training stops after so many passes without a smaller error on the trajectories kept for that."""
    batch: int = 64
    """Windows of 1 s per step of the optimiser."""
    learning_rate: float = 5e-3
    """First learning rate of Adam; it falls to a hundredth of that along a cosine."""
    seed: int = 1
    """Seed of first weights and of the order of windows."""


@dataclass(frozen=True)
class Split:
    """Trajectories to learn from, to stop by, and to measure on."""

    train: list[Trajectory]
    validation: list[Trajectory]
    test: list[Trajectory]


@dataclass(frozen=True)
class Errors:
    """How far a model's torque is from the measured one on held-out trajectories."""

    rms_nm: float
    """Root mean square [N m]."""
    most_nm: float
    """99 % of the errors are smaller [N m]."""
    range_nm: float
    """From the lowest to the highest measured torque [N m]."""

    @property
    def share(self) -> float:
        """RMS error over range."""
        return self.rms_nm / self.range_nm


@dataclass(frozen=True)
class FitResult:
    """A trained network and its errors."""

    network: ActuatorNetwork
    errors: Errors
    pd_errors: Errors
    """Of the best PD law with an offset, for comparison."""
    pd_gains: tuple[float, float]
    """Its stiffness [N m/rad] and damping [N m s/rad]."""
    epochs: int
    """Passes that were made."""
    test: list[Trajectory]
    predicted: list[np.ndarray]
    """Torque of the network for each trajectory of `test` [N m]."""


OnEpoch = Callable[[int, float], None]
"""Called with each epoch and the error on the validation trajectories [N m]."""


def split_trajectories(trajectories: Sequence[Trajectory]) -> Split:
    """Three fifths to learn from, one to stop by and one to measure on.

    Of `MIN_TRAJECTORIES` or more, each goes whole into one part; fewer are cut in time, so that all are in each part.

    Raises:
        ArriveError: too little for that.
    """
    if len(trajectories) >= MIN_TRAJECTORIES:
        parts = [[t for i, t in enumerate(trajectories) if i % 5 in places] for places in ((0, 1, 2), (3,), (4,))]
    else:
        cuts = [(0.0, 0.6), (0.6, 0.8), (0.8, 1.0)]
        parts = [[t.cut(*(round(len(t.torque) * share) for share in cut)) for t in trajectories] for cut in cuts]
    for part in parts:
        longest = max((len(t.torque) * t.period_s for t in part), default=0.0)
        if longest < WINDOW_S:
            raise ArriveError(
                f"the logs are too short: each part needs {WINDOW_S:g} s in one piece, and one has {longest:g} s"
            )
    return Split(*parts)


def fit_network(
    trajectories: Sequence[Trajectory],
    config: FitConfig,
    data: str = "",
    on_epoch: OnEpoch = lambda epoch, error_nm: None,
) -> FitResult:
    """Train a network, stop early, and measure it on trajectories that training has not seen.

    Args:
        trajectories: of one period; see `read_logs`.
        data: description of the data, for the file.
        on_epoch: called with each epoch and the error on the validation trajectories [N m].

    Raises:
        ArriveError: the logs are too short or their torque is constant, or the configuration makes no sense.
    """
    split = split_trajectories(trajectories)
    scales = _scales(split.train)
    torch.manual_seed(config.seed)
    period = split.train[0].period_s
    module = _make_module(config, period)
    epochs = _train(module, split, scales, config, on_epoch)
    weights = {name: value.detach().numpy().copy() for name, value in module.state_dict().items()}
    taps_s = config.taps_s if config.architecture == "taps" else ()
    network = ActuatorNetwork(config.architecture, weights, period, *scales, taps_s=taps_s, data=data)
    predicted = [predict(network, trajectory) for trajectory in split.test]
    errors = _errors(split.test, predicted)
    gains = _best_pd(split.train)
    return FitResult(
        replace(network, error_nm=errors.rms_nm),
        errors,
        _errors(split.test, [_pd(gains, trajectory) for trajectory in split.test]),
        (float(gains[0]), float(gains[1])),
        epochs,
        split.test,
        predicted,
    )


def predict(network: ActuatorNetwork, trajectory: Trajectory) -> np.ndarray:
    """(steps,) torque along a logged trajectory, by what runs in simulation [N m]."""
    runtime = make_runtime(network, 1)
    inputs = np.stack([trajectory.error, trajectory.velocity], axis=1).astype(np.float32)
    return np.array([runtime.step(error, velocity)[0] for error, velocity in inputs[:, :, None]])


def _make_module(config: FitConfig, period_s: float) -> nn.Module:
    units = config.units or {"lstm": (8, 8), "taps": (32, 32, 32)}[config.architecture]
    if min(units) < 1 or (config.architecture == "lstm" and len(set(units)) > 1):
        raise ArriveError(f"--units must be positive, and equal for `lstm`, not {' '.join(map(str, units))}")
    if config.architecture == "lstm":
        return LstmModule(units[0], len(units))
    if not config.taps_s:
        raise ArriveError("--taps-s needs at least one delay")
    steps = [tap / period_s for tap in config.taps_s]
    if not all(math.isclose(step, round(step), abs_tol=1e-3) for step in steps):
        raise ArriveError(f"--taps-s must be multiples of the period of {period_s:g} s")
    return TapsModule([round(step) for step in steps], units)


def _scales(trajectories: Sequence[Trajectory]) -> tuple[float, float, float]:
    """Scales of error [1/rad], velocity [s/rad] and torque [N m] that make the network's numbers about one."""
    sizes = []
    for name in ("error", "velocity", "torque"):
        size = float(np.sqrt(np.mean(np.concatenate([getattr(t, name) for t in trajectories]) ** 2)))
        if not size > 0.0:
            raise ArriveError(f"the {name} is zero throughout the logs: nothing can be learnt from them")
        sizes.append(size)
    return 1.0 / sizes[0], 1.0 / sizes[1], sizes[2]


def _windows(trajectories: Sequence[Trajectory], scales: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    """(n, time, 2) scaled inputs and (n, time) scaled torques: windows that overlap by their warm-up."""
    inputs, torques = [], []
    for trajectory in trajectories:
        length, skip = (round(span / trajectory.period_s) for span in (WINDOW_S, WARM_UP_S))
        table = np.stack([trajectory.error * scales[0], trajectory.velocity * scales[1], trajectory.torque / scales[2]])
        for start in range(0, table.shape[1] - length + 1, length - skip):
            inputs.append(table[:2, start : start + length].T)
            torques.append(table[2, start : start + length])
    first, second = (torch.from_numpy(np.array(part, dtype=np.float32)) for part in (inputs, torques))
    return first, second


def _train(
    module: nn.Module, split: Split, scales: tuple[float, float, float], config: FitConfig, on_epoch: OnEpoch
) -> int:
    """Adam on the mean squared error; leaves the weights with the smallest validation error, returns the epochs."""
    inputs, torques = _windows(split.train, scales)
    held_inputs, held_torques = _windows(split.validation, scales)
    skip = round(WARM_UP_S / split.train[0].period_s)
    optimiser = torch.optim.Adam(module.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs, 0.01 * config.learning_rate)
    best, best_epoch, weights = math.inf, 0, module.state_dict()
    for epoch in range(1, config.epochs + 1):
        for rows in torch.randperm(len(inputs)).split(config.batch):
            loss = (module(inputs[rows]) - torques[rows])[:, skip:].square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(module.parameters(), 1.0)
            optimiser.step()
        schedule.step()
        with torch.no_grad():
            error = float((module(held_inputs) - held_torques)[:, skip:].square().mean().sqrt()) * scales[2]
        on_epoch(epoch, error)
        if error < best:
            best, best_epoch = error, epoch
            weights = {name: value.clone() for name, value in module.state_dict().items()}
        elif epoch - best_epoch >= config.patience:
            break
    if not math.isfinite(best):
        raise ArriveError("training diverged: choose a smaller --learning-rate")
    module.load_state_dict(weights)
    return epoch


def _errors(trajectories: Sequence[Trajectory], predicted: Sequence[np.ndarray]) -> Errors:
    """Over all steps, the first ones from rest too."""
    measured = np.concatenate([trajectory.torque for trajectory in trajectories])
    off = np.abs(np.concatenate(predicted) - measured)
    return Errors(float(np.sqrt(np.mean(off**2))), float(np.quantile(off, 0.99)), float(np.ptp(measured)))


def _best_pd(trajectories: Sequence[Trajectory]) -> np.ndarray:
    """Stiffness, damping and offset of the PD law with the smallest squared error."""
    rows = np.concatenate([np.stack([t.error, -t.velocity, np.ones_like(t.error)], axis=1) for t in trajectories])
    return np.linalg.lstsq(rows, np.concatenate([t.torque for t in trajectories]), rcond=None)[0]


def _pd(gains: np.ndarray, trajectory: Trajectory) -> np.ndarray:
    return gains[0] * trajectory.error - gains[1] * trajectory.velocity + gains[2]
