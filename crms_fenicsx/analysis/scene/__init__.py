"""The scene: a membrane with its supports, cables, bars and loads, in its current state."""

from crms_fenicsx.analysis.scene.scene import Scene

__all__ = ["Scene"]
