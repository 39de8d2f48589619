"""Settings with which a run takes seconds."""

SHORT = [
    "task.episode_s=0.6",
    "task.episode_min_s=0.6",
    "task.reward_window_s=0.3",
    "ppo.hidden=[16]",
    "ppo.num_steps=8",
    "terrain.levels=2",
    "terrain.variants=1",
]
"""Of 30 policy steps per episode."""
SMALL = (
    "task.episode_s=0.4",
    "task.episode_min_s=0.4",
    "task.reward_window_s=0.4",
    "ppo.hidden=[16]",
    "ppo.num_steps=8",
    "terrain.levels=2",
)
"""Of 20."""
