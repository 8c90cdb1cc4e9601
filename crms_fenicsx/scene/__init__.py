"""The scene: a membrane, where it is held, its cables, bars and loads, and its current state."""

from crms_fenicsx.scene.scene import Scene

__all__ = ["Scene"]
