"""Policies that bring a legged robot to a target by a given time, after Rudin et al. (2022)."""

__version__ = "0.1.0"
