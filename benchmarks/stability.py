"""Do the paper's three changes make training more stable (its section II-E)?

    python benchmarks/stability.py --samples 5e6
    python benchmarks/stability.py --grounds flat gap=0.2 --seeds 1 2 3 --samples 2e7 --threads 1

The paper takes 48 instead of 24 steps per iteration and episodes of 6 instead of 20 s, and does not bootstrap
time-outs. A preset has its own numbers: 12 steps and 5 to 8 s in `robust`, 48 steps and 6 s in `paper`. Compared are
the preset as it is, with half of its steps, with episodes of 20 s, with bootstrapped time-outs, and with all of these.

All runs have the same number of samples. A seed succeeds if its policy reaches the success rate `--goal` by the
protocol of maximum difficulty. The same command continues an interrupted benchmark. stability.json has the results so
far and is enough to continue from; `arrive report --stability` shows it.
"""

import statistics
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import torch
import tyro
from trainings import LAST_SHARE, Results, Training, command, markdown

from arrive.config import Config, override
from arrive.learning.rundir import commit
from arrive.presets import get_preset

OURS = "as it is"
LONG_S = 20.0
"""Length of episodes before the paper's change [s]."""
BOOTSTRAPPING = Path(__file__).parent / "bootstrapping.py"


@dataclass(frozen=True)
class Variant:
    """Settings of one kind of training."""

    words: str
    settings: tuple[str, ...] = ()
    """Changes to the configuration, as PATH=VALUE."""
    module: Path | None = None
    """Module to import."""


@dataclass
class Arguments:
    """Trainings, and the criterion for success."""

    samples: float = 5e6
    """Policy steps of every run."""
    grounds: tuple[str, ...] = ("flat", "gap=0.2")
    """Terrain families to train on. A family with a parameter needs the value to measure at: NAME=VALUE."""
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    preset: str = "robust"
    goal: float = 0.9
    """Success rate from which a seed succeeds."""
    episodes: int = 200
    threads: int = 0
    set: tuple[str, ...] = ()
    """Settings of all runs, as PATH=VALUE."""
    out: Path = Path("runs/stability")


def variants(config: Config) -> dict[str, Variant]:
    """The configuration as it is, then with each change undone, then with all undone."""
    steps, shortest, longest = config.ppo.num_steps, config.task.episode_min_s, config.task.episode_s
    episodes = f"{longest:g} s" if shortest == longest else f"{shortest:g} to {longest:g} s"
    half = (f"ppo.num_steps={steps // 2}",)
    long = (f"task.episode_s={LONG_S}", f"task.episode_min_s={LONG_S}")
    return {
        OURS: Variant(f"{steps} steps per iteration, episodes of {episodes}, time-outs not bootstrapped"),
        "half steps": Variant(f"{steps // 2} instead of {steps} steps per iteration", half),
        "20 s": Variant(f"episodes of {LONG_S:g} s instead of {episodes}", long),
        "bootstrapped": Variant("bootstrapped time-outs", module=BOOTSTRAPPING),
        "all": Variant(
            f"{steps // 2} steps, episodes of {LONG_S:g} s and bootstrapped time-outs", (*half, *long), BOOTSTRAPPING
        ),
    }


def main(arguments: Arguments) -> None:
    """Train and measure the missing runs, one after the other, and print the table."""
    torch.set_num_threads(1)
    choices = variants(override(get_preset(arguments.preset), arguments.set))
    results = Results(
        arguments.out / "stability.json",
        partial(content, arguments, choices),
        names=("seed", "ground", "variant"),
        extended=("grounds", "seeds", "goal"),
    )
    # Seeds in the outer loop, so that an interrupted benchmark has complete comparisons.
    wanted = product(arguments.seeds, arguments.grounds, choices)
    for run in results.complete(wanted, partial(run_of, arguments, choices)):
        print(f"{run['ground']}, {run['variant']}, seed {run['seed']}: {run['success']:.1%}", flush=True)
    print(table(arguments, choices, results.runs()))


def run_of(arguments: Arguments, choices: dict[str, Variant], seed: int, ground: str, name: str) -> dict[str, Any]:
    """Train and measure one run."""
    variant = choices[name]
    folder = arguments.out / f"{ground} {name} {seed}".replace(" ", "-").replace("=", "-")
    settings = (*arguments.set, *variant.settings)
    training = Training(
        folder, ground, seed, arguments.samples, arguments.preset, settings, arguments.threads, variant.module
    )
    policy = training.finish()
    measured = training.measure(policy, arguments.episodes)
    origin = {"ground": ground, "variant": name, "seed": seed, "samples": policy.samples, "commit": policy.commit}
    return origin | {key: measured[key] for key in ("success", "interval")} | training.critic()


def content(arguments: Arguments, choices: dict, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """All results so far as JSON data."""
    return {
        "runs": runs,
        "variants": {name: variant.words for name, variant in choices.items()},
        "protocol": {
            "name": "stability",
            "preset": arguments.preset,
            "samples": arguments.samples,
            "goal": arguments.goal,
            "grounds": list(dict.fromkeys(run["ground"] for run in runs)),
            "seeds": sorted({run["seed"] for run in runs}),
            "episodes": arguments.episodes,
            "set": list(arguments.set),
            "last_share": LAST_SHARE,
        },
        "command": command(),
        "commit": commit(),
    }


def table(arguments: Arguments, choices: dict, runs: list[dict[str, Any]]) -> str:
    """A row per ground and variant."""
    rows = []
    for ground in dict.fromkeys(run["ground"] for run in runs):
        for name, variant in choices.items():
            mine = [run for run in runs if (run["ground"], run["variant"]) == (ground, name)]
            if not mine:
                continue
            shares = [run["success"] for run in mine]
            good = sum(share >= arguments.goal for share in shares)
            critic = (statistics.mean(run[key] for run in mine) for key in ("explained_variance", "value_loss"))
            spread = f"{min(shares):.1%} to {max(shares):.1%}"
            rows.append(
                [ground, variant.words, f"{good} of {len(mine)}", spread, *(f"{value:.3f}" for value in critic)]
            )
    head = ["terrain", "training", "seeds that succeed", "success", "explained variance", "value loss"]
    return markdown(head, rows)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
