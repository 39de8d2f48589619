"""`arrive showreel`: the animated picture of the README."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arrive.commands.policies import need
from arrive.errors import ArriveError
from arrive.policies import SHIPPED, shipped_names
from arrive.policies.solved import TELLING, solved_beside

if TYPE_CHECKING:
    from PIL import Image

    from arrive.commands.options import Showreel


def showreel(command: Showreel) -> None:
    """Film policies on terrain that they solve, and write one animated picture.

    Raises:
        ArriveError: no policy was evaluated, no robot arrives, or this machine cannot draw.
    """
    need("onnxruntime")
    from arrive.play.skills import open_skill
    from arrive.render.showreel import frames, record_episode, write_showreel
    from arrive.terrain import FAMILIES
    from arrive.terrain.ground import Ground

    pictures: list[Image.Image] = []
    for name, family in _scenes(command.policies):
        skill = open_skill(name)
        if family is None:
            ground = skill.ground("evaluation")
        else:
            ground = Ground(FAMILIES[family], skill.value(family), "evaluation")
        episode = record_episode(skill, ground)
        if episode is None:
            print(f"{name}: left out, it does not arrive on {ground.words}")
            continue
        print(f"{name}: {episode.caption}, {(len(episode.qpos) - 1) * episode.control_dt:.1f} s", flush=True)
        pictures += frames(episode)
    if not pictures:
        raise ArriveError("no robot arrived, so there is nothing to show")
    print(f"showreel: {command.out} ({write_showreel(pictures, command.out) / 1e6:.2f} MB)")


def _scenes(policies: tuple[str, ...]) -> list[tuple[str, str | None]]:
    """Policies and terrains: the named policies on the terrain on which they open; without names, for each terrain the
    shipped policy that solves the hardest value."""
    if policies:
        return [(name, None) for name in policies]
    solved = {name: solved_beside(SHIPPED / name) for name in shipped_names()}
    best = {}
    for family in TELLING:
        able = [name for name in solved if family in solved[name]]
        if able:
            best[family] = max(able, key=lambda name: solved[name][family])
    if not best:
        raise ArriveError("no shipped policy was evaluated: run arrive eval --protocol difficulty, or name policies")
    return [(name, family) for family, name in best.items()]
