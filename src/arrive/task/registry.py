"""Tasks by name; a new task is one module and one line here."""

from arrive.registry import add, get
from arrive.task.continuous import ContinuousPositionTask
from arrive.task.final import FinalPositionTask
from arrive.task.task import Task, TaskConfig
from arrive.task.velocity import VelocityTask

TASKS: dict[str, type[Task]] = {}


def register_task(task: type[Task]) -> type[Task]:
    """Add a task under the name in its configuration, which `--task NAME` then chooses; a decorator.

    Raises:
        ArriveError: the name is taken.
    """
    name = task.Config().name
    add("task", TASKS, name, task)
    TaskConfig.kinds[name] = task.Config
    return task


def get_task(name: str) -> type[Task]:
    """The task of that name.

    Raises:
        ArriveError: no such task; the message lists them.
    """
    return get("task", TASKS, name)


for built_in in (FinalPositionTask, ContinuousPositionTask, VelocityTask):
    register_task(built_in)
