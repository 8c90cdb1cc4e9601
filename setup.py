"""Write the commit into what is built, which reports of an installed package print."""

import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE, FILE = Path(__file__).parent, Path("crms_fenicsx", "COMMIT")


def write_commit(folder: str) -> None:
    """Write it below a folder; an archive without a clone has the file already."""
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*", "--abbrev=8"]
    try:
        done = subprocess.run(describe, cwd=HERE, capture_output=True, text=True, check=False)
    except OSError:
        return
    if (HERE / ".git").exists() and done.stdout:
        Path(folder, FILE).write_text(done.stdout)


class Build(build_py):
    """Build of a wheel."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            write_commit(self.build_lib)


class Archive(sdist):
    """Source archive, from which wheels are built."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        write_commit(base_dir)


setup(cmdclass={"build_py": Build, "sdist": Archive})
