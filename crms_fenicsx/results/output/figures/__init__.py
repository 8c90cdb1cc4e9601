"""Pictures of scenes, paths and histories."""
