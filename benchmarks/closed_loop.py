"""Compares the exported controller with the network it was exported from, over the episodes of `arrive eval`.

    python benchmarks/closed_loop.py RUN [--terrain flat,rough] [--level 0] [--episodes 1000] [--seed 1] [--pushes 15]

First the network acts in the training environment, as in `arrive eval`. Then one controller per robot acts in the same
environment, with onnxruntime in float32 and with the same noise. 1,000 episodes take about two minutes per terrain.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import torch
from rich.progress import Progress

from arrive.config import override
from arrive.deployment.opening import open_policy
from arrive.errors import ArriveError
from arrive.evaluation.arrival import cells_of
from arrive.evaluation.closed_loop import compare, comparison_summary
from arrive.learning.policy import load_policy
from arrive.terrain import parse_families


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run folder or policy file")
    parser.add_argument("--terrain", default="flat,rough")
    parser.add_argument("--level", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=1000, help="per terrain")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pushes", type=float, help="mean time between pushes [s]; by default as in training")
    parser.add_argument("--threads", type=int, default=1, help="physics threads")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    policy, file = load_policy(arguments.run), open_policy(str(arguments.run))
    if arguments.pushes is not None:
        config = override(policy.config, (f"randomisation.push_interval_s={arguments.pushes}",))
        policy = replace(policy, config=config)
    cells = cells_of(policy.config, parse_families(arguments.terrain), arguments.level)
    with Progress(transient=True) as bar:
        steps = bar.add_task("network, then controllers", total=None)
        rows = compare(
            policy,
            file,
            cells,
            arguments.episodes,
            arguments.seed,
            arguments.threads,
            lambda i, n: bar.update(steps, completed=i, total=n),
        )
    for row in rows:
        print(comparison_summary(row))


if __name__ == "__main__":
    try:
        main()
    except ArriveError as error:
        raise SystemExit(f"closed_loop: {error}") from None
