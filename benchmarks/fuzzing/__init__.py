"""Random scenes and the properties that their answers must have."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tests" / "scenes"))  # their meshes
