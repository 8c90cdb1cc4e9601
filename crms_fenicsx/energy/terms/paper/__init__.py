"""The step-wise laws of the paper, as alternatives to the total ones."""
