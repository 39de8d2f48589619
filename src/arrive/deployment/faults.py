"""Why the controller does not act."""


class BadInput(Exception):
    """An input or result the policy must not act on; its message is the reason given with the safe stance."""


class Fallen(BadInput):
    """The robot lies or topples: nothing is wrong with the inputs, but no policy was trained for it."""
