"""`arrive drive`: drive the simulated robot with a gamepad or a script."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arrive.commands.policies import need
from arrive.config import saved_config
from arrive.errors import ArriveError, Interrupted

if TYPE_CHECKING:
    from arrive.commands.options import Drive


def run_drive(command: Drive) -> None:
    """Drive a policy's deployment controller and print a summary.

    Raises:
        Interrupted: a signal ended it before its script or its time was over.
    """
    need("onnxruntime")
    from arrive.deployment import Controller, ControlLog
    from arrive.deployment.opening import open_policy
    from arrive.drive import session
    from arrive.drive.driver import Driver
    from arrive.drive.gamepad import Gamepad
    from arrive.drive.script import read_script
    from arrive.drive.status import StatusLine, summarise
    from arrive.learning.interrupt import interruptible
    from arrive.robots import get_robot
    from arrive.simulation import SimulatedRobot, continued
    from arrive.terrain.ground import ground_of

    policy = open_policy(command.policy)
    config = saved_config(policy.meta["training"]["config"], policy.path)
    tile = ground_of(command.terrain, command.level, config.terrain.levels).build(
        command.seed, get_robot(config.robot).size
    )
    script = read_script(command.script) if command.script else None
    controls = script or Gamepad()
    seconds = command.seconds or (script.end_s if script else math.inf)
    if not seconds:
        raise ArriveError(
            f"{command.script} ends at 0 s, with its last line: add one, such as 5,0,0, or give --seconds"
        )
    log = ControlLog() if command.log else None
    driver = Driver(SimulatedRobot(config, continued(tile)), Controller(policy, log=log))
    status = StatusLine()
    # Signals end the drive after a step, so that the log is written.
    with interruptible() as interrupted:
        try:
            statistics = session.run(
                driver, controls, seconds, status.report, real_time=script is None, stop=interrupted
            )
        finally:
            status.close()
            controls.close()
            if log and command.log:
                log.save(command.log)
    print(summarise(statistics))
    if log:
        print(f"log: {command.log}")
    if math.isfinite(seconds) and statistics.time_s < seconds - driver.control_dt:
        raise Interrupted(f"interrupted after {statistics.time_s:.1f} of {seconds:g} s")
