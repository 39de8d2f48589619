"""Tasks by name. A new task needs one module and one line here."""

from arrive.registry import add, get
from arrive.task.continuous import ContinuousPositionTask
from arrive.task.final import FinalPositionTask
from arrive.task.task import Task, TaskConfig
from arrive.task.velocity import VelocityTask

TASKS: dict[str, type[Task]] = {}


def register_task(task: type[Task]) -> type[Task]:
    """Decorator that adds a task under the name in its configuration, for `--task NAME`.

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
