"""How fast this machine simulates, collects and learns."""

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from mujoco.batch import Batch

from arrive.build import OnProgress, build_env
from arrive.config import Config
from arrive.env import ArriveEnv
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.logs import RunLog
from arrive.learning.schedule import settings_at
from arrive.learning.threads import one_torch_thread
from arrive.learning.trainer import Trainer
from arrive.physics.engine import STATE_FIELDS, Physics
from arrive.physics.options import PhysicsConfig

RATES = ("engine", "env", "collect", "update_samples_per_s", "train_samples_per_s")
"""The measured rates, each in policy steps or samples per second."""


class RawEngine:
    """`mujoco.batch` alone, fed with the models, states and actions that an environment's physics is about to step."""

    def __init__(self, physics: Physics, config: PhysicsConfig, threads: int):
        self._physics = physics
        self._takes_targets = config.motor != "network"
        self._batch = Batch(physics.model_of_env(0), physics.num_envs, threads)
        self._views = {name: self._batch.bind(name) for name in STATE_FIELDS}

    def load(self, joint_targets: np.ndarray) -> None:
        """Take over models and states; `joint_targets` is (num_envs, joints) [rad].

        An actuator network's torques are not computed: those of the last physics step stay.
        """
        self._batch.set_models([self._physics.model_of_env(i) for i in range(self._physics.num_envs)])
        for name, value in self._physics.state_dict().items():
            if name in self._views:
                self._views[name][:] = value.numpy()
        if self._takes_targets:
            self._views["ctrl"][:] = joint_targets

    def state(self, name: str) -> np.ndarray:
        """(num_envs, ...) one of `STATE_FIELDS`."""
        return self._views[name]

    def step(self) -> None:
        """One policy step of every environment."""
        self._batch.step(None, nstep=self._physics.decimation)


def bench_throughput(
    config: Config,
    threads: int,
    rounds: int,
    start_from: Path | None = None,
    progress: OnProgress = lambda done, total: None,
) -> dict[str, Any]:
    """Measure every rate once per round, so that a disturbance of the machine affects all rates.

    A round has three parts: the steps of one iteration by the environment and by the raw engine, from the same states;
    one iteration with separate times for collection and update; one whole iteration with its log. Actions are the
    policy's, with exploration noise.

    Args:
        config: as for training.
        threads: number of threads of physics and of torch.
        rounds: number of rounds, after a first one that is not measured.
        start_from: run whose networks act. With new networks, the robots fall.

    Returns:
        medians by the names in `RATES`, their ranges, and what was measured, as JSON data.
    """
    before = _memory_kib()
    env = build_env(config, threads=threads, learning=True)
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(config, env, Path(folder))
        if start_from is not None:
            trainer.warm_start(start_from / CHECKPOINT_NAME)
        log = RunLog(Path(folder))
        bench = _Bench(trainer, env, log, threads)
        bench.round()
        bench.clear()
        memory = (_memory_kib() - before) / config.num_envs
        for done in range(rounds):
            bench.round()
            progress(done + 1, rounds)
        log.close()
    return _result(bench, config, memory) | {"threads": threads, "rounds": rounds, "device": str(env.device)}


def _result(bench: "_Bench", config: Config, memory_kib: float) -> dict[str, Any]:
    """Medians and ranges of the rounds, and what was measured, as JSON data."""
    rates = {name: median(values) for name, values in bench.rates.items()}
    return {
        **rates,
        "env_over_engine": median(bench.ratios),
        "ranges": {name: [min(values), max(values)] for name, values in bench.rates.items()},
        "share": _shares(rates),
        "memory_per_env_kib": memory_kib,
        "num_envs": config.num_envs,
        "num_steps": config.ppo.num_steps,
        "networks": list(config.ppo.hidden),
        "precision": config.ppo.precision,
        "terrain": list(config.terrain.families),
    }


class _Bench:
    """The rounds of one measurement."""

    def __init__(self, trainer: Trainer, env: ArriveEnv, log: RunLog, threads: int):
        self._trainer, self._env, self._log = trainer, env, log
        self._settings = settings_at(trainer.config, spent=0.0, seeking=1.0)
        self._steps = trainer.config.ppo.num_steps
        self._samples = env.num_envs * self._steps
        self._engine = RawEngine(env.physics, trainer.config.physics, threads)
        self.clear()

    def clear(self) -> None:
        """Discard all measurements."""
        self.rates: dict[str, list[float]] = {name: [] for name in RATES}
        self.ratios: list[float] = []

    def round(self) -> None:
        """Measure everything once."""
        engine_s, env_s = self._simulate()
        self._note("engine", engine_s)
        self._note("env", env_s)
        self.ratios.append(engine_s / env_s)
        self._note("collect", _seconds(self._trainer.collect))
        self._note("update_samples_per_s", _seconds(lambda: self._trainer.learn(self._settings)))
        self._note("train_samples_per_s", _seconds(self._iterate))

    def _note(self, name: str, seconds: float) -> None:
        self.rates[name].append(self._samples / seconds)

    def _iterate(self) -> None:
        self._trainer.iterate(self._log.write)

    @one_torch_thread()
    @torch.inference_mode()
    def _simulate(self) -> tuple[float, float]:
        """Seconds that the raw engine and the environment took for the same steps."""
        env, engine_s, env_s = self._env, 0.0, 0.0
        actor = self._trainer.algorithm.get_policy()
        observations = env.get_observations()
        for _ in range(self._steps):
            actions = actor(observations, stochastic_output=True)
            self._engine.load(env.joint_targets(actions).numpy())
            engine_s += _seconds(self._engine.step)
            start = time.perf_counter()
            observations = env.step(actions)[0]
            env_s += time.perf_counter() - start
        self._trainer.look()
        return engine_s, env_s


def _seconds(action: Callable[[], Any]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def _shares(rates: dict[str, float]) -> dict[str, float]:
    """Share of an iteration's time that physics, the rest of the environment, acting, and learning take.

    What is left between two measurements counts as nothing where another process made the smaller part the longer one.
    """
    per_sample = {name: 1.0 / rates[name] for name in RATES}
    parts = {
        "physics": per_sample["engine"],
        "environment": max(per_sample["env"] - per_sample["engine"], 0.0),
        "acting": max(per_sample["collect"] - per_sample["env"], 0.0),
        "learning": per_sample["update_samples_per_s"],
    }
    whole = sum(parts.values())
    return {name: part / whole for name, part in parts.items()}


def _memory_kib() -> float:
    """The most memory this process has held [KiB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024 if sys.platform == "darwin" else float(peak)
