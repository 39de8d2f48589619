"""Describes the state of the robot in plain words."""

from html import escape

from arrive.drive.pace import Pace
from arrive.play.playground import Playground

NEWS = 2
"""Number of the newest messages to show."""
RESTING, MOVING, DONE, WRONG = "resting", "moving", "done", "wrong"
"""Kinds of status, each with a colour in page.css."""


def status_html(playground: Playground, pace: Pace) -> str:
    """The robot's activity, ground, speed and last event."""
    kind, title, words = doing(playground)
    speed = f"{pace.factor:.1g} of real time" if 0.0 < pace.factor < 1.0 else "" if pace.factor else "paused"
    falls = f"{playground.falls} fall{'' if playground.falls == 1 else 's'}" if playground.falls else ""
    facts = [f"{playground.speed:.1f} m/s", f"{playground.time_s:.1f} s", speed, falls]
    news = "".join(f"<li>{escape(message)}</li>" for message in list(playground.messages)[-NEWS:])
    return (
        f'<div data-arrive-status="{kind}"><b>{title}</b> <span>{escape(words)}</span>'
        f"<div>{escape(playground.skill.name)}: {escape(playground.ground.words)}</div>"
        f"<div>{', '.join(filter(None, facts))}</div><ul>{news}</ul></div>"
    )


def doing(playground: Playground) -> tuple[str, str, str]:
    """The robot's activity: its kind, a title of a word or two, and the rest of the sentence."""
    command, distance = playground.command, playground.distance
    if command.mode == "safe":
        return WRONG, "Safe stance", command.reason
    if command.mode == "fallen":
        return WRONG, "Fallen", command.reason
    if command.mode == "joystick":
        return MOVING, "Driven", "by stick, keys or gamepad"
    if playground.target is None:
        return RESTING, "Waiting", "Press Go, or click on the ground."
    left = playground.target.arrive_at_s - playground.time_s
    if playground.is_there:
        return DONE, "At the target", f"{distance:.2f} m from its middle" + (f", {left:.1f} s left" if left > 0 else "")
    if left > 0.0:
        return MOVING, "On its way", f"{distance:.1f} m to go, {left:.1f} s left"
    return WRONG, "Late", f"{distance:.1f} m to go, time is over"
