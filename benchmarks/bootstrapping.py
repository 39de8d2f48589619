"""Imported with `--import`: the value at a time-out is bootstrapped as if the episode went on.

It mimics an infinite horizon, which a task that observes its remaining time does not have; the paper removes it.
"""

from arrive.task.final import FinalPositionTask

FinalPositionTask.bootstraps = True
