"""Energy of the robots' motors, summed over all physics steps."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from arrive.env import ArriveEnv
from arrive.physics.device import make_physics
from arrive.physics.engine import Physics
from arrive.physics.motors import motor_network


class MeteredPhysics:
    """An engine that is stepped one physics step at a time and whose motors are read after each.

    Torques change within a policy step: read at its end alone, squared torques would come out too small. A torque acts
    during the physics step that it was computed for, so that its work is torque * speed after the step * timestep.
    """

    def __init__(self, engine: Physics, decimation: int, timestep_s: float):
        """Meter an engine whose own decimation is 1.

        Args:
            decimation: physics steps per policy step.
        """
        self._engine, self._decimation, self._timestep_s = engine, decimation, timestep_s
        self._active = torch.ones(engine.num_envs, dtype=torch.bool, device=engine.device)
        zeros = torch.zeros(engine.num_envs, dtype=torch.double, device=engine.device)
        self.torque_sq = zeros.clone()
        """(num_envs,) integral of the joints' squared torques over time [N^2 m^2 s]."""
        self.positive_work = zeros.clone()
        """(num_envs,) work of the motors: integral of the positive parts of torque * speed of each joint [J]."""
        self.absolute_work = zeros.clone()
        """(num_envs,) the same of its absolute values, of motors that brake at a cost [J]."""

    def __getattr__(self, name: str) -> Any:
        """All but stepping is the engine's own."""
        return getattr(self._engine, name)

    def deactivate(self, env_ids: Tensor) -> None:
        self._active[env_ids] = False
        self._engine.deactivate(env_ids)

    def step(self, joint_targets: Tensor) -> None:
        for _ in range(self._decimation):
            self._engine.step(joint_targets)
            readings = self._engine.read()
            self._add(readings.joint_torque, readings.joint_vel, readings.finite)

    def _add(self, torque: Tensor, speed: Tensor, finite: Tensor) -> None:
        counted = (self._active & finite)[:, None]
        torque = torch.where(counted, torque, 0.0).double()
        power = torque * torch.where(counted, speed, 0.0)
        self.torque_sq += torque.square().sum(-1) * self._timestep_s
        self.positive_work += power.clamp(min=0.0).sum(-1) * self._timestep_s
        self.absolute_work += power.abs().sum(-1) * self._timestep_s


def meter(env: ArriveEnv, threads: int) -> MeteredPhysics:
    """Put a meter into an environment, whose robots then start their first episode again."""
    config = env.config.physics
    single = replace(config, decimation=1)
    engine = make_physics(env.robot, env.pool.worlds, single, env.num_envs, threads, env.device, motor_network(single))
    env.physics = metered = MeteredPhysics(engine, config.decimation, config.timestep_s)
    env.restart()
    return metered
