"""How a joint target becomes a joint torque inside the physics step."""

from arrive.actuation.clip import motor_torque
from arrive.actuation.motor import Motor, add_motors

__all__ = ["Motor", "add_motors", "motor_torque"]
