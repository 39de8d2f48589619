"""Import this with `--import` to bootstrap the value at a time-out, as if the episode went on.

This approximates an infinite horizon. The paper removes it, because a task that observes its remaining time has an end.
"""

from arrive.task.final import FinalPositionTask

FinalPositionTask.bootstraps = True
