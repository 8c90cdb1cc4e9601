"""Geometry on a triangulated surface: places, paths, sections, closest points."""
