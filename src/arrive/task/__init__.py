"""The tasks: commands, observations, rewards, terminations and curriculum, as plain functions."""
