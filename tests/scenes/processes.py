"""Programs that tests run in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

SCENES = Path(__file__).parent
ROOT = SCENES.parents[1]
MPIRUN = ("mpirun", "-n", "3")


def run(
    script: str, *launcher: str, module: Sequence[str] = ()
) -> subprocess.CompletedProcess[str]:
    """Run a program, on several ranks after the words that start them."""
    return subprocess.run(
        [*launcher, sys.executable, *module, "-c", script],
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{SCENES}"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
