"""Reasons why the policy must not act."""


class BadInput(Exception):
    """A bad input or result. Its message is the reason in the command."""


class Fallen(BadInput):
    """The robot lies or topples. The inputs are good, but no policy was trained for this."""
