"""Run time against error: what `benchmarks/accuracy_vs_time.py` is made of."""
