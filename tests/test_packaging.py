"""What is installed: files, version, dependencies; and that its descriptions agree."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import crms_fenicsx

ROOT = Path(__file__).parents[1]


def test_a_wheel_has_the_templates_of_reports_and_the_type_marker(tmp_path: Path) -> None:
    """As setuptools finds them: the patterns in pyproject.toml miss what has moved."""
    pytest.importorskip("setuptools", "77")
    for name in ("crms_fenicsx", "pyproject.toml", "README.md", "LICENSE", "LICENSE.GPL"):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, tmp_path / name)
    code = "from setuptools import setup; setup(script_args=['-q', 'build_py', '-d', 'built'])"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True)
    assert files(tmp_path / "built" / "crms_fenicsx") == files(ROOT / "crms_fenicsx")


def files(folder: Path) -> set[str]:
    """All files of a package but what Python caches."""
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_version_has_the_commit_in_a_clone_and_of_a_wheel(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    release = crms_fenicsx._RELEASE
    assert re.fullmatch(r"\d+\.\d+\.\d+", release)
    assert (ROOT / "CHANGELOG.md").read_text().partition("\n## ")[2].startswith(f"{release} (20")
    monkeypatch.setenv("CRMS_COMMIT", "1a2b3c4d-dirty")
    in_clone = f"{release}+g1a2b3c4d.dirty" if (ROOT / ".git").exists() else release
    assert crms_fenicsx.__version__ == in_clone
    monkeypatch.setattr(crms_fenicsx, "__file__", str(tmp_path / "crms_fenicsx" / "__init__.py"))
    assert crms_fenicsx.__version__ == release
    (tmp_path / "crms_fenicsx").mkdir()
    (tmp_path / "crms_fenicsx" / "COMMIT").write_text("5e6f7a8b\n")  # a wheel
    assert crms_fenicsx.__version__ == f"{release}+g5e6f7a8b"


@pytest.mark.skipif(not shutil.which("git"), reason="needs git")
def test_what_is_built_has_the_commit(tmp_path: Path) -> None:
    """In a wheel from a clone, and in one from an archive, beside which there is none."""
    pytest.importorskip("setuptools", "77")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", "LICENSE.GPL"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "crms_fenicsx").mkdir()
    shutil.copy(ROOT / "crms_fenicsx" / "__init__.py", tmp_path / "crms_fenicsx")

    def made(folder: Path, *command: str) -> str:
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        return done.stdout.strip()

    git = ("git", "-c", "user.name=a", "-c", "user.email=a@b")
    made(tmp_path, "git", "init", "-q")
    made(tmp_path, "git", "add", "-A")
    made(tmp_path, *git, "commit", "-qm", "first")
    commit = made(tmp_path, "git", "rev-parse", "--short=8", "HEAD")
    made(tmp_path, sys.executable, "setup.py", "-q", "build_py", "-d", "built")
    assert (tmp_path / "built" / "crms_fenicsx" / "COMMIT").read_text().strip() == commit
    shutil.rmtree(tmp_path / "built")
    made(tmp_path, sys.executable, "setup.py", "-q", "sdist", "--formats=tar")
    (archive,) = (tmp_path / "dist").glob("*.tar")
    away = tmp_path.parent / f"{tmp_path.name}_archive"
    away.mkdir()
    shutil.unpack_archive(archive, away)
    (folder,) = away.iterdir()
    made(folder, sys.executable, "setup.py", "-q", "build_py", "-d", "built")
    written = (folder / "built" / "crms_fenicsx" / "COMMIT").read_text()
    assert written.removesuffix("-dirty\n").strip() == commit


def test_one_version_of_ruff_checks_everywhere() -> None:
    versions = {
        version
        for file in (".ci/run", ".pre-commit-config.yaml", "CONTRIBUTING.md")
        for version in re.findall(r"(?:ruff_version=|ruff==|version )(\d[\d.]+\d)", text(file))
    }
    assert len(versions) == 1


def test_conda_and_pip_install_the_same() -> None:
    """The dependencies of the package are in both lists."""
    listed = re.search(
        r"^dependencies = \[\n(.*?)^\]", text("pyproject.toml"), re.DOTALL | re.MULTILINE
    )
    assert listed
    for requirement in re.findall(r'"([^"]+)"', listed[1]):
        name, bounds = re.match(r"([\w-]+)(.*)", requirement).groups()
        assert re.search(
            rf"^  - {name}\b *{re.escape(bounds)}( #.*)?$", text("environment.yml"), re.MULTILINE
        )


def text(file: str) -> str:
    """Text of a file of the repository."""
    return (ROOT / file).read_text()
