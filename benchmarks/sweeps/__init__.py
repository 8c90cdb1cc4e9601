"""Sweeps of `benchmarks/stability.py`: parameters taken to numerical extremes."""
