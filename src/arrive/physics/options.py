"""Settings of the physics step."""

from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco

from arrive.actuation.clip import MotorClip
from arrive.actuation.motor import MotorKind
from arrive.errors import ArriveError
from arrive.fields import Count, NotNegative, Positive, Range, Rule, check

CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}

LEAST_TIME_STEPS = 2
"""Physics steps below which MuJoCo raises the time constant of a contact or a joint limit without saying so."""


@dataclass(frozen=True)
class PhysicsConfig:
    """How MuJoCo is stepped; the defaults are legged_gym's rates with solver settings checked by an accuracy test."""

    timestep_s: Positive = 0.005
    """Physics step [s]."""
    decimation: Count = 4
    """Physics steps per policy step."""
    engine: Literal["auto", "mujoco", "warp"] = "auto"
    """`mujoco` on CPU threads, `warp` on a GPU (or, slowly, on a CPU); `auto` takes the one that suits the device."""
    motor: MotorKind = "dc"
    """`dc`: PD with the affine torque-speed limit of the paper; `ideal`: PD with the effort limit alone; `network`: an
    actuator network, which `motor_file` names."""
    motor_file: str = ""
    """Actuator network of `motor=network`: a file written by `arrive actuator fit`."""
    motor_clip: MotorClip = "affine"
    """What cuts the torque of `motor=network`: the paper's `affine` torque-speed limit, the `constant` effort limit, or
    `none`."""
    leg_contacts: bool = True
    """Whether the robot's legs collide with each other; `false`, for comparison, lets them pass through each other."""
    solver_iterations: Count = 15
    """Upper bound on Newton iterations of the contact solver."""
    line_search_iterations: Count = 40
    """Upper bound on line-search iterations of the contact solver; with 10 it stops at steps that throw the robot."""
    solver_tolerance: NotNegative = 1e-5
    """Newton stops when the scaled improvement falls below this."""
    cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    """Friction cone. `pyramidal`, MuJoCo's default, is a quarter faster and holds only 71 % of the friction along the
    diagonals of the world's axes; `elliptic` holds all of it in every direction."""
    impratio: Positive = 20.0
    """Stiffness of friction relative to the contact normal; at MuJoCo's 1 the feet of a standing robot creep apart."""
    contact_time_s: Positive = 0.01
    """Time constant of contacts, at least two physics steps, for MuJoCo takes no shorter one [s]."""
    contact_impedance: Annotated[float, Range(0.0, 1.0, above=True, below=True)] = 0.97
    """How hard contacts are, 0 to 1: the softer, the faster a standing robot's feet creep."""
    max_contacts: Count = 64
    """Contacts per robot for which MuJoCo Warp makes room; the CPU engine needs no bound."""

    def __post_init__(self):
        if (self.motor == "network") != bool(self.motor_file):
            raise ArriveError(
                "physics.motor=network and physics.motor_file=FILE go together; physics.motor is "
                f"{self.motor!r} and physics.motor_file {self.motor_file!r}"
            )
        if self.motor != "network" and self.motor_clip != "affine":
            raise ArriveError(f"physics.motor_clip is for physics.motor=network, not for {self.motor!r}")

    def rules(self) -> tuple[Rule, ...]:
        """What fields must be because of others."""
        least = LEAST_TIME_STEPS * self.timestep_s
        must = f"at least {LEAST_TIME_STEPS} physics steps, {least:.6g} s, for MuJoCo takes no shorter time"
        return (Rule("contact_time_s", must, self.contact_time_s >= least * (1.0 - 1e-9)),)

    @property
    def control_dt(self) -> float:
        """Time between policy steps [s]."""
        return self.timestep_s * self.decimation


def apply_options(spec: mujoco.MjSpec, config: PhysicsConfig) -> None:
    """Write the solver settings into a spec.

    The Jacobian stays dense: a robot has few degrees of freedom (ANYmal C: 18), and MuJoCo 4.0.0 factorises wrongly
    where the constraint Jacobian is sparse. Searching for islands is left out: a robot is one. A diverged simulation is
    not silently put back to its start: the environment must see it.

    Raises:
        ArriveError: a setting is out of its range, or MuJoCo would silently raise the time constant of a joint's limit.
    """
    check(config)
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
