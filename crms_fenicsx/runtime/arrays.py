"""Types of arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int32]
"""Local numbers, as DOLFINx and PETSc take them."""
Integers = npt.NDArray[np.int64]
"""Global numbers."""
