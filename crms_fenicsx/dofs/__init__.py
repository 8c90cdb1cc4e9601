"""Unknowns: their layout on the ranks and the sizes of matrix rows."""
