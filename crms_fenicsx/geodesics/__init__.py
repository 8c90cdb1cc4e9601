"""Shortest paths on a triangulated surface."""
