"""Robots by name; a new one is a module beside this file and a line in `ROBOTS`."""

from arrive.errors import unknown_name
from arrive.robots.anymal_c import ANYMAL_C
from arrive.robots.robot import Robot
from arrive.robots.unitree_go2 import GO2

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (ANYMAL_C, GO2)}


def get_robot(name: str) -> Robot:
    """The registered robot called `name`; raises `ArriveError` naming the valid ones if there is none."""
    if name not in ROBOTS:
        raise unknown_name("robot", name, ROBOTS)
    return ROBOTS[name]


__all__ = ["ROBOTS", "Robot", "get_robot"]
