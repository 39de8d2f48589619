"""A ROS 2 node that runs an exported policy: joint state, odometry, ground and a goal in, joint positions out.

    python examples/ros2/arrive_node.py --ros-args -p policy:=robot.onnx -r odom:=/your/odometry

| topic | type | what |
|---|---|---|
| `joint_states` | sensor_msgs/JointState | positions and velocities, in any order |
| `odom` | nav_msgs/Odometry | pose in the world frame, twist in the base frame |
| `elevation_map` | grid_map_msgs/GridMap | layer `layer` (`elevation`), in the frame of `odom` |
| `points` | sensor_msgs/PointCloud2 | instead of a map: ground points without the robot's own, in the frame of `odom` |
| `goal` | geometry_msgs/PoseStamped | a point on the ground, in the frame of `odom`; approached at `speed` (0.75 m/s) |
| `joy` | sensor_msgs/Joy | axes 1 and 0 walk while button `deadman` (4) is held; letting go stops |
| `commands` (out) | std_msgs/Float64MultiArray | joint positions for ros2_control's forward_command_controller [rad] |
| `status` (out) | std_msgs/String | the controller's mode, and its reason |

The node follows the latest goal, but the joystick has priority. Without grid_map_msgs there is no topic
`elevation_map`. The drives must run with the stiffness and damping that the node logs. The node publishes commands from
the first step in which all inputs are valid.
"""

import math

import rclpy
from conversions import height_map_of, point_cloud_of, seconds, sensors_of
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState, Joy, PointCloud2
from std_msgs.msg import Float64MultiArray, String

from arrive.deployment import Controller, Joystick, Target

try:
    from grid_map_msgs.msg import GridMap
except ImportError:
    GridMap = None

STICK_AGE_S = 0.5
"""Without a joystick message for this time, the stick is taken as released [s]."""
STOP = Joystick(0.0, 0.0)


class ArriveNode(Node):
    """Steps the controller periodically, with the newest message of every topic."""

    def __init__(self):
        """Load the policy and subscribe to the topics.

        Raises:
            ArriveError: the policy cannot be run.
        """
        super().__init__("arrive")
        self.controller = Controller.load(self._parameter("policy", "robot.onnx"))
        self._layer, self._deadman = self._parameter("layer", "elevation"), self._parameter("deadman", 4)
        self._speed = self._parameter("speed", 0.75)
        self._joints = self._odometry = self._terrain = self._stick = None
        self._stick_s, self._goal, self._begun = -math.inf, STOP, False
        self._commands = self.create_publisher(Float64MultiArray, "commands", 1)
        self._status = self.create_publisher(String, "status", 1)
        for kind, topic, receive in (
            (JointState, "joint_states", self._receive_joints),
            (Odometry, "odom", self._receive_odometry),
            (GridMap, "elevation_map", self._receive_map),
            (PointCloud2, "points", self._receive_points),
            (PoseStamped, "goal", self._receive_goal),
            (Joy, "joy", self._receive_joy),
        ):
            if kind is not None:
                self.create_subscription(kind, topic, receive, 1)
        robot = self.controller.policy.robot
        self.get_logger().info(f"{robot.name}: the drives need {robot.stiffness} N m/rad, {robot.damping} N m s/rad")
        self.create_timer(self.controller.policy.period_s, self.step)

    def step(self) -> None:
        """One control step."""
        now_s = 1e-9 * self.get_clock().now().nanoseconds
        sensors = None
        if self._joints is not None and self._odometry is not None:
            sensors = sensors_of(self._joints, self._odometry, self.controller.policy.robot.joint_names)
        command = self.controller.step(sensors, self._goal_at(now_s), self._terrain, now_s)
        self._begun = self._begun or command.mode not in ("safe", "fallen")
        if self._begun:
            self._commands.publish(Float64MultiArray(data=command.targets.tolist()))
        self._status.publish(String(data=f"{command.mode} {command.reason}".rstrip()))

    def _goal_at(self, now_s: float) -> Joystick | Target:
        """The stick while it is held; a stop after it is released; otherwise the latest goal."""
        if self._stick is not None and now_s - self._stick_s > STICK_AGE_S:
            self._stick, self._goal = None, STOP
        return self._goal if self._stick is None else self._stick

    def _receive_joints(self, message: JointState) -> None:
        self._joints = message

    def _receive_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def _receive_map(self, message) -> None:
        self._take_ground(message, lambda: height_map_of(message, self._layer))

    def _receive_points(self, message: PointCloud2) -> None:
        self._take_ground(message, lambda: point_cloud_of(message))

    def _take_ground(self, message, convert) -> None:
        """Store the ground of a message. Warn if the message is unusable, and keep the last ground."""
        try:
            if self._in_world(message):
                self._terrain = convert()
        except (ValueError, TypeError, AttributeError, IndexError) as error:
            self._warn(str(error))

    def _receive_goal(self, message: PoseStamped) -> None:
        if self._odometry is None or not self._in_world(message):
            return
        place, base = message.pose.position, self._odometry.pose.pose.position
        height = place.z + self.controller.policy.task.target_height_m
        travel_s = math.dist((place.x, place.y), (base.x, base.y)) / self._speed
        start_s = max(1e-9 * self.get_clock().now().nanoseconds, seconds(message.header.stamp))
        self._goal = Target((place.x, place.y, height), start_s + travel_s)

    def _receive_joy(self, message: Joy) -> None:
        if self._deadman < len(message.buttons) and message.buttons[self._deadman] and len(message.axes) >= 2:
            self._stick = Joystick(forward=message.axes[1], left=message.axes[0])
            self._stick_s = 1e-9 * self.get_clock().now().nanoseconds
        elif self._stick is not None:
            self._stick, self._goal = None, STOP

    def _in_world(self, message) -> bool:
        """Whether a message is in the frame of the odometry. Other frames are not supported."""
        if self._odometry is None:
            return False
        frame, world = message.header.frame_id, self._odometry.header.frame_id
        if frame != world:
            self._warn(f"a message in the frame {frame!r} is ignored, the odometry's is {world!r}")
        return frame == world

    def _parameter(self, name: str, default: str | float):
        return self.declare_parameter(name, default).value

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=1.0)


def main() -> None:
    rclpy.init()
    node = ArriveNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
