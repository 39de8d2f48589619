"""Latency of a control step on a robot, and the memory of the process that runs it."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from arrive.errors import ArriveError

HIDDEN = (512, 256, 128)
"""The paper's networks."""
STEPS = 100_000
TARGETS = {"median": 0.2, "p99": 1.0, "resident": 150.0}
"""Limits for the controller: milliseconds, and megabytes for the last."""


def bench_deployment(
    policies: tuple[Path, ...] = (), hidden: tuple[int, ...] = HIDDEN, steps: int = STEPS, seed: int = 1
) -> dict[str, Any]:
    """Measure the control step of each policy in a process of its own that has NumPy and onnxruntime alone.

    Args:
        policies: exported files. A network of the given size with random weights comes first: weights do not change
            the time.
        hidden: sizes of that network's hidden layers.
        steps: timed per policy, after a warm-up.
        seed: of the random weights.

    Returns:
        `steps`, `targets` and, per policy under `policies`: `name`, `hidden`, `latency_ms` (median, p99, max),
        `resident_mb`, and `met`, whether the targets are.

    Raises:
        ArriveError: no steps, no such file, or the controller could not run it.
    """
    if steps < 1:
        raise ArriveError(f"steps must be at least 1, not {steps}")
    for path in policies:  # before minutes are spent on the first
        _hidden_sizes(path)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "random.onnx"
        _export_random(made, hidden, seed)
        rows = [_measure(made, "random weights", steps)]
    rows += [_measure(path, str(path), steps) for path in policies]
    return {"steps": steps, "targets": dict(TARGETS), "policies": rows}


def _measure(path: Path, name: str, steps: int) -> dict[str, Any]:
    hidden = _hidden_sizes(path)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    program = [sys.executable, "-m", "arrive.bench.control_loop", str(path), str(steps)]
    process = subprocess.run(program, env=environment, capture_output=True, text=True)
    if process.returncode:
        raise ArriveError(f"the control loop of {path} failed: {process.stderr.strip().splitlines()[-1]}")
    found = json.loads(process.stdout)
    if found["refused"] or found["foreign_modules"]:
        raise ArriveError(
            f"the control loop of {path} is no measure: {found['refused']} steps were refused, and it imported "
            f"{', '.join(found['foreign_modules']) or 'nothing it must not'}"
        )
    latency, resident = found["latency_ms"], found["resident_mb"]
    met = all(latency[what] <= TARGETS[what] for what in ("median", "p99")) and resident < TARGETS["resident"]
    return {"name": name, "hidden": hidden, "latency_ms": latency, "resident_mb": resident, "met": met}


def _hidden_sizes(path: Path) -> list[int]:
    """Sizes of the hidden layers of an exported network."""
    import onnx

    from arrive.deployment.policy_file import read_policy_file

    read_policy_file(path)
    shapes = [tuple(tensor.dims) for tensor in onnx.load(path).graph.initializer]
    return [shape[0] for shape in shapes if len(shape) == 2][:-1]


def _export_random(path: Path, hidden: tuple[int, ...], seed: int) -> None:
    """An untrained policy for the default robot and task."""
    import torch
    from tensordict import TensorDict

    from arrive.config import check_config, override
    from arrive.deployment.export import export_policy, policy_sections
    from arrive.env import POLICY
    from arrive.learning.policy import Policy
    from arrive.learning.ppo import make_actor
    from arrive.presets import robust

    config = override(robust(), (f"ppo.hidden={list(hidden)}",))
    check_config(config)
    content = policy_sections(config)
    sample = TensorDict({POLICY: torch.zeros(1, content["observation"][-1]["stop"])}, batch_size=[1])
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        actor = make_actor(config.ppo, sample, len(content["robot"]["joint_names"]), 0)
    export_policy(Policy(path, config, content["observation"], "none", 0, actor), path)


def print_deployment(result: dict[str, Any]) -> None:
    """Print a `bench_deployment` as a table."""
    targets = result["targets"]
    table = Table(
        "policy",
        "hidden layers",
        f"median (<= {targets['median']:g} ms)",
        f"p99 (<= {targets['p99']:g} ms)",
        "maximum",
        f"memory (< {targets['resident']:g} MB)",
        "",
        title=f"one control step on one core, {result['steps']:,} steps",
    )
    for row in result["policies"]:
        latency = [f"{row['latency_ms'][what]:.3f} ms" for what in ("median", "p99", "max")]
        memory, met = f"{row['resident_mb']:.0f} MB", "met" if row["met"] else "missed"
        table.add_row(row["name"], "-".join(map(str, row["hidden"])), *latency, memory, met)
    Console().print(table)
