"""Motors that are computed outside MuJoCo."""

from pathlib import Path

from arrive.actuation.network import ActuatorNetwork
from arrive.actuation.network_file import read_network
from arrive.actuation.network_motors import NetworkMotors
from arrive.physics.options import PhysicsConfig
from arrive.robots.robot import Robot


def motor_network(config: PhysicsConfig) -> ActuatorNetwork | None:
    """The actuator network of `physics.motor=network`; None for motors inside MuJoCo.

    Raises:
        ArriveError: the file cannot be used, see `read_network`.
    """
    return read_network(Path(config.motor_file), config.timestep_s) if config.motor == "network" else None


def network_motors(
    config: PhysicsConfig, robot: Robot, num_envs: int, network: ActuatorNetwork | None
) -> NetworkMotors | None:
    """The motors of `num_envs` robots in NumPy; None for motors inside MuJoCo."""
    assert (network is not None) == (config.motor == "network"), "targets would be taken for torques"
    if network is None:
        return None
    return NetworkMotors(network, robot.motors, config.motor_clip, num_envs)
