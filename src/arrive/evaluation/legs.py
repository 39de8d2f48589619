"""Whether a robot's legs overlap: they touch or, with `physics.leg_contacts=false`, pass through each other."""

import mujoco
import numpy as np

from arrive.robots.robot import Robot

OF_LEGS = 1
"""Collision bit of all shapes of the robot while its own are compared."""


class LegCrossing:
    """Finds poses in which collision shapes of different legs overlap."""

    def __init__(self, robot: Robot):
        """Compile the robot alone, its shapes colliding with each other."""
        spec = robot.build_spec(False)
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = OF_LEGS
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(name).qposadr[0] for name in robot.joint_names]
        self._joints = np.array(joints)
        self._leg_of_geom = self._legs(robot)

    def _legs(self, robot: Robot) -> np.ndarray:
        """(ngeom,) body at which each shape's leg begins, 0 for shapes of the base."""
        model, base = self._model, self._model.body(robot.base_body).id
        leg = np.zeros(model.nbody, dtype=int)
        for body in range(model.nbody):
            parent = model.body_parentid[body]
            leg[body] = body if parent == base and body != base else leg[parent]
        return leg[model.geom_bodyid]

    def found(self, joint_pos: np.ndarray) -> np.ndarray:
        """(n,) bool for (n, joints) joint positions [rad]: some leg overlaps another one."""
        crossing = np.zeros(len(joint_pos), dtype=bool)
        for row, pose in enumerate(joint_pos):
            self._data.qpos[self._joints] = pose
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            legs = self._leg_of_geom[self._data.contact.geom[: self._data.ncon]]
            crossing[row] = bool(((legs[:, 0] != legs[:, 1]) & (legs > 0).all(-1)).any()) if len(legs) else False
        return crossing
