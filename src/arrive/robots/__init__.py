"""Robots by name; a new one is a module beside this file and a line in `ROBOTS`."""

from arrive.registry import add, get
from arrive.robots.anymal_c import ANYMAL_C
from arrive.robots.check import check_model
from arrive.robots.robot import Robot
from arrive.robots.unitree_go2 import GO2

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (ANYMAL_C, GO2)}


def get_robot(name: str) -> Robot:
    """The registered robot called `name`; raises `ArriveError` naming the valid ones if there is none."""
    return get("robot", ROBOTS, name)


def register_robot(robot: Robot) -> None:
    """Add a robot of one's own, which `--robot NAME` then chooses; see docs/extend.md.

    Raises:
        ArriveError: the name is taken, or the model is not what `Robot` asks for.
    """
    check_model(robot)
    add("robot", ROBOTS, robot.name, robot)


__all__ = ["ROBOTS", "Robot", "get_robot", "register_robot"]
