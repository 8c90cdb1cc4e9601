"""How right results are: finer meshes, orders of convergence and error bars."""
