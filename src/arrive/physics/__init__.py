"""Physics engines behind one protocol."""

from arrive.physics.engine import Physics, Readings
from arrive.physics.options import PhysicsConfig

__all__ = ["Physics", "PhysicsConfig", "Readings"]
