"""Colours that tell a robot's legs and joints apart, whatever they are called and however many there are."""

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
    """As many colours; after the eighth they begin again."""
    return list(islice(cycle(PALETTE), count))


def hexadecimal(colour: Rgb) -> str:
    """As a page writes it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def leg_names(foot_names: tuple[str, ...]) -> tuple[str, ...]:
    """Prefixes of the feet's names: LF of LF_FOOT, FL of FL_foot; the whole name if it has no prefix."""
    return tuple(name.partition("_")[0] for name in foot_names)


def joint_kinds(joint_names: tuple[str, ...], foot_names: tuple[str, ...]) -> tuple[str, ...]:
    """A joint's name within its leg: HAA of LF_HAA. Joints of the same kind share it in all legs."""
    legs = set(leg_names(foot_names))
    split = ((name, *name.partition("_")[::2]) for name in joint_names)
    return tuple(rest if leg in legs and rest else name for name, leg, rest in split)
