"""Actuator networks on MuJoCo Warp's device: one thread per joint, one kernel per physics step.

The kernels take the matrices that NumPy uses, see `arrive.actuation.runtime`, and do the same arithmetic in float32.
"""

# ruff: noqa: RUF046, UP018 - Warp wants a constructor where a loop changes a variable

from collections.abc import Sequence

import mujoco_warp as mjw
import numpy as np
import warp as wp
from torch import Tensor

from arrive.actuation.clip import MotorClip, TorqueClip
from arrive.actuation.motor import Motor
from arrive.actuation.network import ActuatorNetwork
from arrive.actuation.network_motors import PREFIX
from arrive.actuation.runtime import lstm_matrices, taps_matrices

UNLIMITED = float(np.finfo(np.float32).max)
"""Torque that stands for no limit [N m]."""


@wp.struct
class MotorData:
    """What every joint of every robot reads and writes; limits are (num_joints,)."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    target: wp.array2d[float]
    ctrl: wp.array2d[float]
    weights: wp.array[float]
    units: wp.array[int]
    stall: wp.array[float]
    slope: wp.array[float]
    effort: wp.array[float]


@wp.func
def _error(drive: MotorData, env: int, joint: int):
    return drive.target[env, joint] - drive.qpos[env, 7 + joint]


@wp.func
def _apply(drive: MotorData, env: int, joint: int, torque: float):
    """Cut a torque at the motor's limits and hand it to the next physics step."""
    effort = drive.effort[joint]
    back = drive.slope[joint] * drive.qvel[env, 6 + joint]
    highest = wp.clamp(drive.stall[joint] - back, -effort, effort)
    lowest = wp.clamp(-drive.stall[joint] - back, -effort, effort)
    drive.ctrl[env, joint] = wp.clamp(torque, lowest, highest)


@wp.func
def _sigmoid(half: float):
    """The sigmoid of twice its argument; the matrices have the half."""
    return 0.5 + 0.5 * wp.tanh(half)


@wp.kernel
def _lstm(drive: MotorData, hidden: wp.array3d[float], cell: wp.array3d[float], fresh: wp.array3d[float]):
    env, joint = wp.tid()
    at, before, base, size = int(0), int(0), int(0), int(2)
    for layer in range(drive.units.shape[0]):
        units = drive.units[layer]
        width = size + 1 + units
        for unit in range(units):
            entry, forget, exit_, candidate = float(0.0), float(0.0), float(0.0), float(0.0)
            for column in range(width):
                value = float(1.0)
                if column > size:
                    value = hidden[env, joint, base + column - size - 1]
                elif column < size:
                    if layer > 0:
                        value = fresh[env, joint, before + column]
                    elif column == 0:
                        value = _error(drive, env, joint)
                    else:
                        value = drive.qvel[env, 6 + joint]
                entry += drive.weights[at + unit * width + column] * value
                forget += drive.weights[at + (units + unit) * width + column] * value
                exit_ += drive.weights[at + (2 * units + unit) * width + column] * value
                candidate += drive.weights[at + (3 * units + unit) * width + column] * value
            kept = _sigmoid(forget) * cell[env, joint, base + unit]
            cell[env, joint, base + unit] = kept + _sigmoid(entry) * wp.tanh(candidate)
            fresh[env, joint, base + unit] = _sigmoid(exit_) * wp.tanh(cell[env, joint, base + unit])
        at += 4 * units * width
        before = base
        base += units
        size = units
    for unit in range(base):
        hidden[env, joint, unit] = fresh[env, joint, unit]
    torque = float(drive.weights[at + size])
    for unit in range(size):
        torque += drive.weights[at + unit] * fresh[env, joint, before + unit]
    _apply(drive, env, joint, torque)


@wp.kernel
def _taps(drive: MotorData, history: wp.array4d[float], fresh: wp.array3d[float]):
    env, joint = wp.tid()
    depth = history.shape[3]
    for back in range(depth - 1):
        age = depth - 1 - back
        for kind in range(2):
            history[env, joint, kind, age] = history[env, joint, kind, age - 1]
    history[env, joint, 0, 0] = _error(drive, env, joint)
    history[env, joint, 1, 0] = drive.qvel[env, 6 + joint]
    at, before, base, size = int(0), int(0), int(0), int(2 * depth)
    for layer in range(drive.units.shape[0]):
        units = drive.units[layer]
        for unit in range(units):
            total = float(drive.weights[at + unit * (size + 1) + size])
            for column in range(size):
                value = float(0.0)
                if layer == 0:
                    value = history[env, joint, column // depth, column % depth]
                else:
                    value = fresh[env, joint, before + column]
                total += drive.weights[at + unit * (size + 1) + column] * value
            fresh[env, joint, base + unit] = total / (1.0 + wp.abs(total))
        at += units * (size + 1)
        before = base
        base += units
        size = units
    torque = float(drive.weights[at + size])
    for unit in range(size):
        torque += drive.weights[at + unit] * fresh[env, joint, before + unit]
    _apply(drive, env, joint, torque)


class WarpMotors:
    """`NetworkMotors` on the present Warp device, for the robots of a MuJoCo Warp simulation."""

    def __init__(self, network: ActuatorNetwork, motors: Sequence[Motor], clip: MotorClip, data: mjw.Data):
        """Start all joints at rest."""
        recurrent = network.architecture == "lstm"
        matrices = (lstm_matrices if recurrent else taps_matrices)(network)
        self._shape = data.ctrl.shape
        self._drive = MotorData()
        self._drive.qpos, self._drive.qvel, self._drive.ctrl = data.qpos, data.qvel, data.ctrl
        self._drive.target = wp.zeros(self._shape, dtype=float)
        self._drive.weights = wp.array(np.concatenate([matrix.ravel() for matrix in matrices]), dtype=float)
        self._drive.units = wp.array(network.units, dtype=int)
        limits = TorqueClip(motors, clip)
        for name in ("stall", "slope", "effort"):
            values = np.full(self._shape[1], np.minimum(getattr(limits, name), UNLIMITED))
            setattr(self._drive, name, wp.array(values, dtype=float))
        total = sum(network.units)
        self._fresh = wp.zeros((*self._shape, total), dtype=float)
        if recurrent:
            self._kernel = _lstm
            self._memory = {name: wp.zeros((*self._shape, total), dtype=float) for name in ("hidden", "cell")}
        else:
            self._kernel = _taps
            self._memory = {"history": wp.zeros((*self._shape, 2, max(network.tap_steps) + 1), dtype=float)}
        self.targets: Tensor = wp.to_torch(self._drive.target)
        """(num_envs, num_joints) joint targets [rad], to be written before a step."""

    def state(self) -> dict[str, Tensor]:
        """Views of everything that is remembered, (num_envs, num_joints, ...) each, named as by `NetworkMotors`."""
        return {PREFIX + name: wp.to_torch(array) for name, array in self._memory.items()}

    def launch(self) -> None:
        """Compute the torques of the next physics step; may be captured in a CUDA graph."""
        wp.launch(self._kernel, dim=self._shape, inputs=[self._drive, *self._memory.values(), self._fresh])
