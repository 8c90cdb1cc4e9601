"""Load steps: increments are solved here; `Solver.advance` divides those that fail."""
