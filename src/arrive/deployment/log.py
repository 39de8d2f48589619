"""A log of every step's inputs and commands, from which the commands can be recomputed."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from arrive.arrays import read_arrays
from arrive.deployment.command import JointCommand
from arrive.deployment.goals import Goal
from arrive.deployment.inputs import ARRAYS, GOALS, TIMES, Frame
from arrive.deployment.policy_file import PolicyFile
from arrive.errors import ArriveError
from arrive.files import write_bytes

KINDS = {kind.__name__: kind for kind in GOALS}


class ControlLog:
    """Records inputs and commands. Of a map or a point cloud it keeps the heights at the grid's points.

    A step takes about 1 kB and 4 B per grid point: 7.7 kB with the 1,683 points of `robust`.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.policy_digest = ""
        self.frames: list[Frame] = []
        self.commands: list[JointCommand] = []

    def append(self, policy: PolicyFile, frame: Frame, command: JointCommand) -> None:
        """Record one step."""
        self.policy_digest = policy.digest
        self.frames.append(frame)
        self.commands.append(command)

    def save(self, path: Path | str) -> None:
        """Write an .npz file of plain arrays and JSON, atomically. Reading it executes nothing.

        Raises:
            ArriveError: the folder cannot be written or the disk is full.
        """
        content: dict[str, Any] = {name: [getattr(frame, name) for frame in self.frames] for name in TIMES}
        for name in ARRAYS:
            values = [getattr(frame, name) for frame in self.frames]
            content[name] = np.concatenate([value.ravel() for value in values]) if values else np.zeros(0)
            content[f"{name}_shapes"] = json.dumps([value.shape for value in values])
        content["targets"] = np.array([command.targets for command in self.commands])
        content["texts"] = json.dumps({
            "policy": self.policy_digest,
            "mistakes": [frame.mistake for frame in self.frames],
            "goals": [_goal_to_json(frame.goal) for frame in self.frames],
            "modes": [command.mode for command in self.commands],
            "reasons": [command.reason for command in self.commands],
        })  # fmt: skip
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **content)
        write_bytes(Path(path), buffer.getvalue())

    @classmethod
    def load(cls, path: Path | str) -> "ControlLog":
        """Read a log.

        Raises:
            ArriveError: the file is missing, damaged or not a controller's log.
        """
        log, content = cls(), read_arrays(Path(path))
        try:
            texts = json.loads(str(content["texts"]))
            arrays = {name: _split(content[name], json.loads(str(content[f"{name}_shapes"]))) for name in ARRAYS}
            times = {name: content[name].tolist() for name in TIMES}
            log.policy_digest = texts["policy"]
            for i, (goal, mistake) in enumerate(zip(texts["goals"], texts["mistakes"], strict=True)):
                columns = {name: values[i] for name, values in (arrays | times).items()}
                log.frames.append(Frame(**columns, goal=_goal_from_json(goal), mistake=mistake))
            rows = zip(content["targets"], texts["modes"], texts["reasons"], strict=True)
            log.commands += [JointCommand(*row) for row in rows]
        except Exception as error:  # whatever another program's arrays make json and NumPy raise
            raise ArriveError(f"cannot read {path}: it is not a controller's log") from error
        return log


def _split(flat: np.ndarray, shapes: list[list[int]]) -> list[np.ndarray]:
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes], dtype=int)
    return (
        [part.reshape(shape) for part, shape in zip(np.split(flat, ends[:-1]), shapes, strict=True)] if shapes else []
    )


def _goal_to_json(goal: Goal | None) -> dict[str, Any] | None:
    return None if goal is None else {"kind": type(goal).__name__} | dataclasses.asdict(goal)


def _goal_from_json(data: dict[str, Any] | None) -> Goal | None:
    if data is None:
        return None
    return KINDS[data.pop("kind")](**data)
