"""Convert ROS 2 messages for the controller. It only reads their fields, so tests need no ROS.

Both sides use the units of REP 103: m, rad, s. Two orders differ: ROS quaternions are (x, y, z, w), and the cells of a
grid_map begin at the corner with the largest x and y.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from arrive.deployment import HeightMap, PointCloud, Sensors

FLOAT32 = 7
"""sensor_msgs/PointField.FLOAT32."""


def seconds(stamp: Any) -> float:
    """A builtin_interfaces/Time [s]."""
    return stamp.sec + 1e-9 * stamp.nanosec


def sensors_of(joints: Any, odometry: Any, names: Sequence[str]) -> Sensors:
    """Measurements of one moment, with the time of the older message.

    Args:
        joints: sensor_msgs/JointState in any order; a missing joint becomes NaN, which the controller rejects.
        odometry: nav_msgs/Odometry, with its twist in the base frame (`child_frame_id`).
        names: the policy's joints, in its order.
    """
    places = {name: i for i, name in enumerate(joints.name)}
    pose, twist = odometry.pose.pose, odometry.twist.twist
    turn = pose.orientation
    return Sensors(
        joint_pos=_in_order(joints.position, places, names),
        joint_vel=_in_order(joints.velocity, places, names),
        base_pos_w=_xyz(pose.position),
        base_quat_w=np.array([turn.w, turn.x, turn.y, turn.z]),
        base_lin_vel_b=_xyz(twist.linear),
        base_ang_vel_b=_xyz(twist.angular),
        time_s=min(seconds(joints.header.stamp), seconds(odometry.header.stamp)),
    )


def height_map_of(message: Any, layer: str) -> HeightMap:
    """The elevation layer of a grid_map_msgs/GridMap.

    Raises:
        ValueError: the layer is missing, or the map is rotated in its frame.
    """
    if layer not in message.layers:
        raise ValueError(f"the grid map has no layer {layer!r}, only {', '.join(message.layers)}")
    info, turn = message.info, message.info.pose.orientation
    if math.hypot(turn.x, turn.y, turn.z) > 1e-6:
        raise ValueError("the grid map is rotated in its frame")
    data = message.data[list(message.layers).index(layer)]
    outer, inner = data.layout.dim
    cells = np.asarray(data.data, dtype=np.float64).reshape(outer.size, inner.size)
    if outer.label == "column_index":
        cells = cells.T
    # A grid map is a ring buffer. Unrolled, x decreases with the row index and y with the column index.
    cells = np.roll(cells, (-message.outer_start_index, -message.inner_start_index), axis=(0, 1))
    corner = (info.pose.position.x - info.length_x / 2, info.pose.position.y - info.length_y / 2)
    return HeightMap(corner, info.resolution, cells[::-1, ::-1], seconds(message.header.stamp))


def point_cloud_of(message: Any) -> PointCloud:
    """The x, y and z of a sensor_msgs/PointCloud2.

    Raises:
        ValueError: one of them is missing or not float32.
    """
    fields = {field.name: field for field in message.fields}
    if not all(name in fields and fields[name].datatype == FLOAT32 for name in "xyz"):
        raise ValueError("the point cloud lacks x, y or z as float32")
    kind = np.dtype({
        "names": list("xyz"),
        "formats": [">f4" if message.is_bigendian else "<f4"] * 3,
        "offsets": [fields[name].offset for name in "xyz"],
        "itemsize": message.point_step,
    })  # fmt: skip
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.row_step)
    points = np.ascontiguousarray(rows[:, : message.width * message.point_step]).view(kind).ravel()
    return PointCloud(np.stack([points[name] for name in "xyz"], axis=1), seconds(message.header.stamp))


def _in_order(values: Sequence[float], places: dict[str, int], names: Sequence[str]) -> np.ndarray:
    """The values in the order of `names`; NaN for missing ones. A message may have no velocities at all."""
    known = [places.get(name, len(values)) for name in names]
    return np.array([values[i] if i < len(values) else math.nan for i in known])


def _xyz(vector: Any) -> np.ndarray:
    return np.array([vector.x, vector.y, vector.z])
