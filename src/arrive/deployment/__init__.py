"""From a trained policy to joint targets on a robot.

`export` needs the training installation. Everything else here needs only NumPy and onnxruntime:

    from arrive.deployment import Controller, Sensors, Target
"""

from arrive.deployment.command import JointCommand
from arrive.deployment.controller import Controller
from arrive.deployment.goals import Goal, Joystick, Target, WayPoints
from arrive.deployment.heights import GridHeights, HeightMap, PointCloud
from arrive.deployment.inputs import Sensors
from arrive.deployment.log import ControlLog
from arrive.deployment.replay import replay
from arrive.deployment.safety import Safety

__all__ = [
    "ControlLog",
    "Controller",
    "Goal",
    "GridHeights",
    "HeightMap",
    "JointCommand",
    "Joystick",
    "PointCloud",
    "Safety",
    "Sensors",
    "Target",
    "WayPoints",
    "replay",
]
