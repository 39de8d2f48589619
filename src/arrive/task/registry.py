"""Tasks by name; a new task is one module and one line here."""

from collections.abc import Callable

import torch

from arrive.config import Config
from arrive.errors import unknown_name
from arrive.task.final import FinalPositionTask
from arrive.task.task import Task
from arrive.terrain.pool import Rasters

TaskFactory = Callable[[Config, Rasters, torch.Generator, tuple[float, float] | None], Task]


TASKS: dict[str, TaskFactory] = {"final": FinalPositionTask}


def get_task(name: str) -> TaskFactory:
    """The task of that name.

    Raises:
        ArriveError: no such task; the message lists them.
    """
    if name not in TASKS:
        raise unknown_name("task", name, TASKS)
    return TASKS[name]
