"""One of two processes that train together, started by torchrun for `learning/test_distributed.py`."""

import sys
from pathlib import Path

import torch

from arrive.build import Placement, build_env
from arrive.config import Config, override
from arrive.learning.ranks import Ranks, join_ranks
from arrive.learning.trainer import Budget, Trainer
from arrive.presets import robust

CONFIG = override(
    robust(),
    (
        "num_envs=6",
        "terrain.levels=2",
        "terrain.variants=1",
        "ppo.num_steps=4",
        "ppo.epochs=1",
        "ppo.mini_batches=1",
        "ppo.desired_kl=0",
        "ppo.hidden=[16]",
    ),
)


def make_trainer(ranks: Ranks, folder: Path, config: Config = CONFIG) -> Trainer:
    """This process's own environments, and networks like the others'."""
    env = build_env(config, Placement(seed_offset=ranks.seed_offset), threads=1)
    return Trainer(config, env, folder, ranks)


def parameters(trainer: Trainer) -> dict[str, torch.Tensor]:
    """Every network parameter by name, copied."""
    return {name: value.detach().clone() for name, value in trainer.state.parameters().items()}


def one_update(ranks: Ranks, folder: Path) -> None:
    """Train one mini-batch; write the parameters before and after it and this process's own gradients."""
    trainer = make_trainer(ranks, folder)
    before, gradients = parameters(trainer), {}
    reduce = trainer.algorithm.reduce_parameters

    def recording() -> None:
        gradients.update({name: value.grad.clone() for name, value in trainer.state.parameters().items()})
        reduce()

    trainer.algorithm.reduce_parameters = recording
    trainer.train(Budget(iterations=1), lambda result: None)
    torch.save({"before": before, "gradients": gradients, "after": parameters(trainer)}, folder / f"{ranks.rank}.pt")


def resume(ranks: Ranks, folder: Path) -> None:
    """Train two iterations, and one with another one after a resume."""
    whole = make_trainer(ranks, folder / "whole")
    whole.train(Budget(iterations=2), lambda result: None)
    make_trainer(ranks, folder / "parts").train(Budget(iterations=1), lambda result: None)
    resumed = make_trainer(ranks, folder / "parts")
    ranks.any(False)  # wait until the first process has written the checkpoint
    resumed.load()
    resumed.train(Budget(iterations=2), lambda result: None)
    observations = [trainer.state.observations["policy"] for trainer in (whole, resumed)]
    content = {"parameters": [parameters(whole), parameters(resumed)], "observations": observations}
    torch.save(content | {"samples": resumed.state.samples}, folder / f"{ranks.rank}.pt")


def spoil(ranks: Ranks, folder: Path) -> None:
    """Let the second process alone meet a NaN; both must go back to the last good state and train on."""
    trainer = make_trainer(ranks, folder)
    trainer.save()
    step, spoilt = trainer.env.step, []

    def spoiling(actions: torch.Tensor):
        observations, rewards, dones, extras = step(actions)
        if ranks.rank == 1 and not spoilt:
            spoilt.append(True)
            rewards = rewards * float("nan")
        return observations, rewards, dones, extras

    trainer.env.step = spoiling
    trainer.train(Budget(iterations=2), lambda result: None)
    torch.save({"after": parameters(trainer), "iteration": trainer.state.iteration}, folder / f"{ranks.rank}.pt")


if __name__ == "__main__":
    torch.set_num_threads(1)
    joined = join_ranks(torch.device("cpu"))
    for part in (one_update, resume, spoil):
        own = Path(sys.argv[1]) / part.__name__
        own.mkdir(exist_ok=True)
        part(joined, own)
    joined.leave()
