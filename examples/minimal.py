"""The shortest program that runs a policy: constant measurements of a standing robot, and one second of commands.

    python examples/minimal.py robot.onnx

It only needs NumPy and onnxruntime, as on a robot's computer. `simulated_robot.py` has a complete control loop.
"""

import sys

import numpy as np

from arrive.deployment import Controller, GridHeights, Joystick, Sensors


def main(path: str) -> None:
    controller = Controller.load(path)
    policy, joints = controller.policy, len(controller.policy.robot.joint_names)
    for step in range(round(1.0 / policy.period_s)):
        now_s = step * policy.period_s
        sensors = Sensors(
            joint_pos=policy.robot.default_joint_pos_rad,
            joint_vel=np.zeros(joints),
            base_pos_w=(0.0, 0.0, policy.robot.standing_height_m),
            base_quat_w=(1.0, 0.0, 0.0, 0.0),
            base_lin_vel_b=np.zeros(3),
            base_ang_vel_b=np.zeros(3),
            time_s=now_s,
        )
        ground = GridHeights(np.zeros(len(policy.grid.points_m)), now_s)
        command = controller.step(sensors, Joystick(forward=0.5, left=0.0), ground, now_s)
        # A robot would now send the targets to its drives, with the gains policy.robot.stiffness and .damping.
    for name, target in zip(policy.robot.joint_names, command.targets, strict=True):
        print(f"{name}: {target:+.3f} rad")
    print(f"mode: {command.mode} {command.reason}".rstrip())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
