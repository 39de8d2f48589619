"""Tasks by name; a new task is one module and one line here."""

from arrive.errors import unknown_name
from arrive.task.continuous import ContinuousPositionTask
from arrive.task.final import FinalPositionTask
from arrive.task.task import Task
from arrive.task.velocity import VelocityTask

TASKS: dict[str, type[Task]] = {
    "final": FinalPositionTask,
    "continuous": ContinuousPositionTask,
    "velocity": VelocityTask,
}


def get_task(name: str) -> type[Task]:
    """The task of that name.

    Raises:
        ArriveError: no such task; the message lists them.
    """
    if name not in TASKS:
        raise unknown_name("task", name, TASKS)
    return TASKS[name]
