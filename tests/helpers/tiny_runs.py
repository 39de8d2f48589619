"""The smallest training, which takes seconds."""

TINY = ("ppo.hidden=[8]", "ppo.num_steps=4", "terrain.levels=1", "terrain.variants=1")


def train_words(iterations: int, out: str = "run") -> list[str]:
    """The words of its command line."""
    words = ["train", "flat", "--num-envs", "4", "--threads", "1", "--iterations", str(iterations), "--out", out]
    return [*words, "--set", *TINY]
