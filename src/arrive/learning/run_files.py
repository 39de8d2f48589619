"""The files from which a training resumes: written together, and read back into exactly the same state."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from arrive.config import Config
from arrive.errors import ArriveError
from arrive.learning.checkpoint import (
    CHECKPOINT_NAME,
    Origin,
    check_fits,
    load_checkpoint,
    save_sealed,
)
from arrive.learning.ranks import Ranks
from arrive.learning.rundir import commit, with_own_motor
from arrive.learning.state import Snapshot, TrainingState, snapshot_from
from arrive.policies import POLICY_NAME


def save_run(state: TrainingState, snapshot: Snapshot, config: Config, folder: Path, ranks: Ranks) -> None:
    """Write checkpoint and policy of a new snapshot.

    Rank 0 writes, and includes the state of the other processes' environments. All processes must call this.

    Raises:
        ArriveError: the folder cannot be written or the disk is full.
    """
    others = ranks.gather(snapshot.own())[1:]
    if not ranks.leads:
        return
    schema = state.env.observer.schema()
    origin = Origin(config.robot, config, schema, commit(), snapshot.iteration, snapshot.samples).content()
    save_sealed(origin | {"state": vars(snapshot) | {"others": others}}, folder / CHECKPOINT_NAME)
    save_sealed(origin | {"actor": state.algorithm.get_policy().state_dict()}, folder / POLICY_NAME)


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run, from its checkpoint."""

    iteration: int = 0
    samples: int = 0
    minutes: float = 0.0


def read_progress(folder: Path) -> RunProgress:
    """Read the progress of a run from its checkpoint; zero if there is none.

    Raises:
        ArriveError: the checkpoint is damaged.
    """
    path = folder / CHECKPOINT_NAME
    if not path.exists():
        return RunProgress()
    origin, state = load_checkpoint(path)
    try:
        return RunProgress(origin.iteration, origin.samples, float(state["elapsed_s"]) / 60.0)
    except (KeyError, TypeError, ValueError) as error:
        raise ArriveError(f"{path} does not contain its training time; it was not written by arrive") from error


def resume_run(state: TrainingState, config: Config, folder: Path, ranks: Ranks) -> None:
    """Resume exactly from the folder's checkpoint.

    Raises:
        ArriveError: there is no readable checkpoint, or its robot, observation, configuration, device, number of
            processes or version differs.
    """
    path = folder / CHECKPOINT_NAME
    origin, saved = load_checkpoint(path)
    check_fits(origin, config.robot, state.env.observer.schema(), path)
    if with_own_motor(origin.config, folder) != config:
        raise ArriveError(f"{path} was made with another configuration than {folder}/config.json")
    try:
        state.restore(_part_of_rank(saved, state, ranks, path))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise ArriveError(
            f"{path} was written by another version of arrive and cannot be resumed; "
            f"start a new run from its networks: --start-from {folder}. ({type(error).__name__})"
        ) from error


def _part_of_rank(saved: dict[str, Any], state: TrainingState, ranks: Ranks, path: Path) -> Snapshot:
    """A checkpoint's state with the parts that belong to this process.

    Raises:
        ArriveError: the number of processes or the kind of device differs.
    """
    snapshot, others = snapshot_from(saved), saved["others"]
    if len(others) + 1 != ranks.count:
        raise ArriveError(f"{path} was made by {len(others) + 1} processes: resume with the same number")
    if snapshot.device != state.env.device.type:
        raise ArriveError(
            f"{path} was made with --device {snapshot.device}: resume with the same device, or start a "
            f"new run with --start-from {path.parent}"
        )
    return snapshot if ranks.leads else replace(snapshot, **others[ranks.rank - 1])
