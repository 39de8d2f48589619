"""Send a simulated robot to a target, with the same control loop as on a real robot.

    python examples/simulated_robot.py [POLICY] [--terrain stairs=0.1] [--fast]

On a robot, replace the clock, `state_estimate` and `height_map` by your own. Here the sensors are noisy, and the map is
0.1 s old and has holes. The loop runs in real time, or as fast as possible with `--fast`.
"""

import argparse
import time
from collections import deque
from dataclasses import replace

import numpy as np

from arrive.config import saved_config
from arrive.deployment import Controller, HeightMap, Sensors, Target
from arrive.deployment.opening import open_policy
from arrive.robots import get_robot
from arrive.simulation import SimulatedRobot
from arrive.terrain.ground import ground_of

DISTANCE_M, TIME_S, STAY_S = 3.0, 6.0, 2.0
MAP_DELAY_STEPS, HOLES = 5, 0.05
rng = np.random.default_rng(0)


def state_estimate(robot: SimulatedRobot, now_s: float) -> Sensors:
    """Measurements with the noise of joint encoders, an inertial measurement unit and odometry."""
    exact = robot.sensors(now_s)
    return replace(
        exact,
        joint_pos=exact.joint_pos + rng.normal(0.0, 0.005, exact.joint_pos.shape),
        joint_vel=exact.joint_vel + rng.normal(0.0, 0.1, exact.joint_vel.shape),
        base_lin_vel_b=exact.base_lin_vel_b + rng.normal(0.0, 0.05, 3),
        base_ang_vel_b=exact.base_ang_vel_b + rng.normal(0.0, 0.05, 3),
    )


def height_map(robot: SimulatedRobot, now_s: float, recent: deque[HeightMap]) -> HeightMap:
    """A map as from a mapping node: delayed, and with cells that no camera has seen."""
    seen = robot.height_map(now_s)
    holes = rng.random(seen.heights_w.shape) < HOLES
    recent.append(replace(seen, heights_w=np.where(holes, np.nan, seen.heights_w)))
    return recent[0]


def main(arguments: list[str] | None = None) -> float:
    """Returns the distance to the target at the end [m]."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", nargs="?", help="run folder, exported file or name; the shipped one by default")
    parser.add_argument("--terrain", default="flat", help="a family, or NAME=VALUE")
    parser.add_argument("--level", type=int, help="one of the policy's own levels")
    parser.add_argument("--fast", action="store_true", help="as fast as the machine can")
    options = parser.parse_args(arguments)
    policy = open_policy(options.policy)
    config = saved_config(policy.meta["training"]["config"], policy.path)
    ground = ground_of(options.terrain, options.level, config.terrain.levels)
    robot = SimulatedRobot(config, ground.build(size=get_robot(config.robot).size))
    controller, recent = Controller(policy), deque(maxlen=MAP_DELAY_STEPS + 1)
    goal = Target((DISTANCE_M, 0.0, policy.task.target_height_m), arrive_at_s=TIME_S)
    steps, mode, start_s = round((TIME_S + STAY_S) / policy.period_s), "", time.monotonic()
    for step in range(steps):
        now_s = step * policy.period_s  # on a robot: time.monotonic(), the clock that also stamps the sensors
        command = controller.step(state_estimate(robot, now_s), goal, height_map(robot, now_s, recent), now_s)
        robot.step(command.targets)  # on a robot: send to the drives, with the gains in policy.robot
        if command.mode != mode:
            mode = command.mode
            print(f"{now_s:5.2f} s  {mode}  {command.reason}".rstrip())
        if not options.fast:
            time.sleep(max(start_s + now_s + policy.period_s - time.monotonic(), 0.0))
    distance = float(np.linalg.norm(robot.base_pos_w - goal.position_w))
    print(f"{distance:.2f} m from the target after {steps * policy.period_s:.0f} s{', fallen' * robot.crashed}")
    return distance


if __name__ == "__main__":
    main()
