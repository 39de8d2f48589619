"""`arrive bench`: how fast this machine simulates, collects and learns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from arrive.bench.deployment import bench_deployment, print_deployment
from arrive.bench.throughput import RATES, bench_throughput
from arrive.commands.files import write_result
from arrive.commands.results import keep_others
from arrive.commands.threads import use_threads
from arrive.errors import ArriveError
from arrive.recipe import make_config
from arrive.terrain import parse_families

if TYPE_CHECKING:
    from arrive.commands.options import Bench

KNOWN_BY = ("env_over_engine", "targets")
"""A key of the result of either measurement."""
LABELS = {
    "engine": "mujoco.batch alone",
    "env": "environment",
    "collect": "collection with the policy",
    "update_samples_per_s": "PPO update",
    "train_samples_per_s": "training, end to end",
}


def bench(command: Bench) -> None:
    """Measure and print the result, and write it to the JSON file if one is named."""
    if command.json is not None:
        keep_others(command.json, lambda found: any(key in found for key in KNOWN_BY), command.force)
    if command.deployment:
        result = bench_deployment(command.policy)
        print_deployment(result)
    else:
        result = _throughput(command)
        _print(result)
    if command.json is not None:
        write_result(command.json, result)


def _throughput(command: Bench) -> dict[str, Any]:
    if command.policy:
        raise ArriveError("--policy needs --deployment; use --start-from for the run whose policy moves the robots")
    threads = use_threads(command.threads)
    families = parse_families(command.terrain)
    config = make_config(families, command.preset, command.task, command.num_envs, None, command.set, command.robot)
    with Progress(transient=True) as bar:
        rounds = bar.add_task("measuring", total=None)
        return bench_throughput(
            config,
            threads,
            command.rounds,
            command.start_from,
            lambda done, total: bar.update(rounds, completed=done, total=total),
        )


def _print(result: dict[str, Any]) -> None:
    table = Table(
        title=f"{result['num_envs']} environments x {result['num_steps']} steps, {result['threads']} threads, "
        f"networks {'-'.join(map(str, result['networks']))} in {result['precision']}, median of {result['rounds']}"
    )
    for title in ("samples/s", "median", "least to most"):
        table.add_column(title, justify="left" if title == "samples/s" else "right")
    for name in RATES:
        low, high = result["ranges"][name]
        table.add_row(LABELS[name], f"{result[name]:,.0f}", f"{low:,.0f} to {high:,.0f}")
    console = Console()
    console.print(table)
    shares = ", ".join(f"{name} {share:.0%}" for name, share in result["share"].items())
    console.print(f"environment over engine {result['env_over_engine']:.3f}; time: {shares}")
    console.print(f"memory {result['memory_per_env_kib']:,.0f} KiB per environment")
