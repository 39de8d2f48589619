"""Policies with which a legged robot reaches a place by a given time, after Rudin et al. (2022)."""

__version__ = "0.1.0"
