"""Run time against error: the parts of `benchmarks/accuracy_vs_time.py`."""
