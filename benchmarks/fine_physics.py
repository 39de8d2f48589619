"""Does a policy that was trained with the fast physics settings arrive as often with fine ones?

    python benchmarks/fine_physics.py RUN [--terrain flat] [--level 0] [--episodes 500] [--threads 0]

Evaluates the policy with its own settings, with MuJoCo's default solver at a physics step of 1 ms, and with MuJoCo's
default contacts on top.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from arrive.commands.threads import use_threads
from arrive.evaluation.arrival import cells_of, evaluate
from arrive.evaluation.policy import load_policy
from arrive.physics.options import PhysicsConfig
from arrive.terrain import parse_families

FINE_STEP_S = 0.001


@dataclass
class Arguments:
    """What to evaluate."""

    policy: tyro.conf.Positional[Path]
    terrain: str = "flat"
    level: int = 0
    episodes: int = 500
    threads: int = 0


def variants(trained: PhysicsConfig) -> dict[str, PhysicsConfig]:
    """The settings to compare, by what to call them."""
    default_solver = replace(
        trained,
        timestep_s=FINE_STEP_S,
        decimation=round(trained.control_dt / FINE_STEP_S),
        solver_iterations=100,
        line_search_iterations=50,
        solver_tolerance=1e-8,
        impratio=1.0,
    )
    default_contacts = replace(default_solver, contact_time_s=0.02, contact_impedance=0.95)
    return {
        "as trained": trained,
        "1 ms, MuJoCo's default solver": default_solver,
        "1 ms, MuJoCo's default solver and contacts": default_contacts,
    }


def main(arguments: Arguments) -> None:
    """Print the arrival rate with each setting."""
    threads = use_threads(arguments.threads)
    policy = load_policy(arguments.policy)
    cells = cells_of(policy.config, parse_families(arguments.terrain), arguments.level)
    for label, physics in variants(policy.config.physics).items():
        config = replace(policy.config, physics=physics)
        results = evaluate(replace(policy, config=config), cells, arguments.episodes, seed=1, threads=threads).results
        for result in results:
            print(f"{result.cell.caption}, {label}: {result.rate}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
