"""Sweeps of `benchmarks/stability.py`: parameters taken to where numbers become difficult."""
