"""Tasks by name; a new task is one module and two lines here."""

from arrive.errors import unknown_name
from arrive.task.continuous import ContinuousConfig, ContinuousPositionTask
from arrive.task.final import FinalConfig, FinalPositionTask
from arrive.task.task import Task
from arrive.task.velocity import VelocityConfig, VelocityTask

TASKS: dict[str, type[Task]] = {
    "final": FinalPositionTask,
    "continuous": ContinuousPositionTask,
    "velocity": VelocityTask,
}
AnyTaskConfig = FinalConfig | ContinuousConfig | VelocityConfig
"""What a configuration's `task` may be; its `name` says which."""


def get_task(name: str) -> type[Task]:
    """The task of that name.

    Raises:
        ArriveError: no such task; the message lists them.
    """
    if name not in TASKS:
        raise unknown_name("task", name, TASKS)
    return TASKS[name]
