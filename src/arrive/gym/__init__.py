"""The tasks as Gymnasium environments, one per terrain family and one with all of them.

    import gymnasium
    import arrive.gym

    gymnasium.register_envs(arrive.gym)
    envs = gymnasium.make_vec("arrive/Gap-v0", num_envs=64)
    env = gymnasium.make("arrive/Gap-v0", render_mode="rgb_array")

Importing this module registers them, because Gymnasium does not search other packages. torch and MuJoCo are imported
when the first environment is made.
"""

import gymnasium

from arrive.terrain import FAMILIES

ALL = "all"


def environment_id(family: str) -> str:
    """The id of a terrain family's environment, or of `all`: `arrive/StairsDown-v0` for `stairs_down`."""
    return f"arrive/{''.join(word.capitalize() for word in family.split('_'))}-v0"


def _register() -> None:
    for family in (*FAMILIES, ALL):
        if environment_id(family) not in gymnasium.registry:
            gymnasium.register(
                id=environment_id(family),
                entry_point="arrive.gym.single:ArriveSingleEnv",
                vector_entry_point="arrive.gym.vector:ArriveVectorEnv",
                kwargs={"terrain": family},
            )


_register()
