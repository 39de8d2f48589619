"""A small replacement of ROS 2: the test controls its topics, timers and clock."""

import sys
import types
from types import SimpleNamespace
from typing import Any


class Message:
    """A message with whatever fields it is given."""

    def __init__(self, **fields: Any):
        self.__dict__.update(fields)


class Publisher:
    """Keeps what is published."""

    def __init__(self):
        self.sent: list[Message] = []

    def publish(self, message: Message) -> None:
        self.sent.append(message)


class Node:
    """What `rclpy.node.Node` offers, as far as examples use it."""

    parameters: dict[str, Any] = {}  # noqa: RUF012 - set by the test before a node is made
    now_s = 0.0

    def __init__(self, name: str):
        self.name = name
        self.publishers: dict[str, Publisher] = {}
        self.receivers: dict[str, Any] = {}
        self.timers: list[tuple[float, Any]] = []
        self.warnings: list[str] = []

    def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters.get(name, default))

    def create_publisher(self, kind: type, topic: str, depth: int) -> Publisher:
        return self.publishers.setdefault(topic, Publisher())

    def create_subscription(self, kind: type, topic: str, receive: Any, depth: int) -> None:
        self.receivers[topic] = receive

    def create_timer(self, period_s: float, call: Any) -> None:
        self.timers.append((period_s, call))

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=round(1e9 * self.now_s)))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=lambda text: None, warning=lambda text, **options: self.warnings.append(text))


MESSAGES = {
    "geometry_msgs": ("PoseStamped",),
    "nav_msgs": ("Odometry",),
    "sensor_msgs": ("JointState", "Joy", "PointCloud2"),
    "std_msgs": ("Float64MultiArray", "String"),
    "grid_map_msgs": ("GridMap",),
}


def install(monkeypatch) -> None:
    """Put the stand-in where the example imports ROS 2 from."""
    rclpy = types.ModuleType("rclpy")
    node = types.ModuleType("rclpy.node")
    node.Node = Node
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "rclpy.node", node)
    for package, names in MESSAGES.items():
        module = types.ModuleType(f"{package}.msg")
        for name in names:
            setattr(module, name, type(name, (Message,), {}))
        monkeypatch.setitem(sys.modules, package, types.ModuleType(package))
        monkeypatch.setitem(sys.modules, module.__name__, module)
