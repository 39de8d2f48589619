"""Colours for the legs and joints of any robot."""

from itertools import cycle, islice

Rgb = tuple[int, int, int]
PALETTE: tuple[Rgb, ...] = (
    (47, 111, 176),
    (224, 122, 31),
    (58, 143, 77),
    (176, 58, 72),
    (124, 84, 168),
    (140, 96, 60),
    (30, 150, 160),
    (200, 90, 150),
)


def palette(count: int) -> list[Rgb]:
    """The first `count` colours. The palette repeats after eight."""
    return list(islice(cycle(PALETTE), count))


def hexadecimal(colour: Rgb) -> str:
    """The colour in HTML notation."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def leg_names(foot_names: tuple[str, ...]) -> tuple[str, ...]:
    """Prefixes of the feet's names, such as LF for LF_FOOT. A name without a prefix is used as it is."""
    return tuple(name.partition("_")[0] for name in foot_names)


def joint_kinds(joint_names: tuple[str, ...], foot_names: tuple[str, ...]) -> tuple[str, ...]:
    """Name of each joint without its leg, such as HAA for LF_HAA: the same for this joint in all legs."""
    legs = set(leg_names(foot_names))
    split = ((name, *name.partition("_")[::2]) for name in joint_names)
    return tuple(rest if leg in legs and rest else name for name, leg, rest in split)
