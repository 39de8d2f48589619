"""What a robot is asked to do: commands, observations, rewards, terminations and curriculum as plain functions."""
