"""Geometry on a triangulated surface: surface points, paths, plane sections, closest points."""
