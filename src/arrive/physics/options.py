"""Settings of the physics step."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import mujoco

from arrive.actuation.clip import MotorClip
from arrive.actuation.motor import MotorKind
from arrive.errors import ArriveError
from arrive.fields import AtLeastOne, NotNegative, Positive, Range, Rule, check_fields

CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}

LEAST_TIME_STEPS = 2
"""Smallest time constant of a contact or a joint limit, in physics steps. MuJoCo silently raises smaller ones."""


@dataclass(frozen=True)
class PhysicsConfig:
    """Settings of MuJoCo's step. Defaults are legged_gym's rates, with solver settings checked by an accuracy test."""

    timestep_s: Positive = 0.005
    """Physics step [s]."""
    decimation: AtLeastOne = 4
    """Physics steps per policy step."""
    engine: Literal["auto", "mujoco", "warp"] = "auto"
    """`mujoco` runs on CPU threads, `warp` on a GPU (or, slowly, on a CPU); `auto` chooses by the device."""
    motor: MotorKind = "dc"
    """`dc`: PD with the paper's affine torque-speed limit; `ideal`: PD with the effort limit only; `network`: the
    actuator network in `motor_file`."""
    motor_file: str = ""
    """Actuator network of `motor=network`: a file written by `arrive actuator fit`."""
    motor_clip: MotorClip = "affine"
    """Clipping of the torque of `motor=network`: the paper's `affine` torque-speed limit, the `constant` effort limit,
    or `none`."""
    leg_contacts: bool = True
    """Whether the robot's legs collide with each other. `false` lets them pass through each other, for comparison."""
    solver_iterations: AtLeastOne = 15
    """Largest number of Newton iterations of the contact solver."""
    line_search_iterations: AtLeastOne = 40
    """Largest number of line-search iterations of the contact solver. With 10, bad solutions throw the robot."""
    solver_tolerance: NotNegative = 1e-5
    """Newton iterations stop when the scaled improvement falls below this."""
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    """Friction cone. `pyramidal`, MuJoCo's default, is a quarter faster but has only 71 % of the friction along the
    diagonals of the world's axes. `elliptic` has the full friction in every direction."""
    impratio: Positive = 20.0
    """Ratio of friction stiffness to normal stiffness. With MuJoCo's default 1, a standing robot's feet creep apart."""
    contact_time_s: Positive = 0.01
    """Time constant of contacts, at least two physics steps, because MuJoCo raises smaller ones [s]."""
    contact_impedance: Annotated[float, Range(0.0, 1.0, above=True, below=True)] = 0.97
    """Hardness of contacts, 0 to 1. With softer contacts a standing robot's feet creep faster."""
    max_contacts: AtLeastOne = 64
    """Room for contacts per robot in MuJoCo Warp. The CPU engine needs no limit."""

    def __post_init__(self) -> None:
        if (self.motor == "network") != bool(self.motor_file):
            raise ArriveError(
                "physics.motor=network and physics.motor_file=FILE go together; physics.motor is "
                f"{self.motor!r} and physics.motor_file {self.motor_file!r}"
            )
        if self.motor != "network" and self.motor_clip != "affine":
            raise ArriveError(f"physics.motor_clip is for physics.motor=network, not for {self.motor!r}")

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between fields."""
        least = LEAST_TIME_STEPS * self.timestep_s
        must = f"at least {LEAST_TIME_STEPS} physics steps, {least:.6g} s, for MuJoCo takes no shorter time"
        return (Rule("contact_time_s", must, self.contact_time_s >= least * (1.0 - 1e-9)),)

    @property
    def control_dt(self) -> float:
        """Time between policy steps [s]."""
        return self.timestep_s * self.decimation


def apply_options(spec: mujoco.MjSpec, config: PhysicsConfig) -> None:
    """Write the solver settings into a spec.

    The Jacobian stays dense: a robot has few degrees of freedom (ANYmal C: 18), and MuJoCo 4.0.0 factorises sparse
    constraint Jacobians wrongly. The search for islands is switched off, because a robot is a single island. MuJoCo's
    automatic reset is switched off, so that the environment sees diverged simulations.

    Raises:
        ArriveError: a setting is out of range, or MuJoCo would silently raise the time constant of a joint limit.
    """
    check_fields(config)
    option = spec.option
    option.timestep = config.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.cone = CONES[config.cone]
    option.impratio = config.impratio
    option.iterations = config.solver_iterations
    option.ls_iterations = config.line_search_iterations
    option.tolerance = config.solver_tolerance
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    least = LEAST_TIME_STEPS * config.timestep_s
    for joint in spec.joints:
        if 0.0 < joint.solref_limit[0] < least * (1.0 - 1e-9) and joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            raise ArriveError(
                f"the limit of joint {joint.name} has a time constant of {joint.solref_limit[0]:g} s, less than "
                f"{LEAST_TIME_STEPS} physics steps: set physics.timestep_s to {joint.solref_limit[0] / 2:g} or less"
            )
    for geom in spec.geoms:
        geom.solref[0] = config.contact_time_s
        geom.solimp[:2] = config.contact_impedance


def with_decimation(config: PhysicsConfig, decimation: int) -> PhysicsConfig:
    """The same policy step in another number of physics steps. Contacts become softer where longer steps need that."""
    timestep_s = config.control_dt / decimation
    contact_time_s = max(config.contact_time_s, LEAST_TIME_STEPS * timestep_s)
    return replace(config, timestep_s=timestep_s, decimation=decimation, contact_time_s=contact_time_s)


def change_decimation(worlds: Iterable[mujoco.MjModel], config: PhysicsConfig, decimation: int) -> PhysicsConfig:
    """Give compiled worlds, in place, the step and contacts of `with_decimation`. Returns that configuration."""
    config = with_decimation(config, decimation)
    for world in worlds:
        world.opt.timestep = config.timestep_s
        world.geom_solref[:, 0] = config.contact_time_s
    return config
