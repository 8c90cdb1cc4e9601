"""The script `run`, with stand-ins for the programs that install and that enter the root."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STAND_INS = {
    "apt-get": """
case $* in *--assume-no*) echo "Need to get 12 MB of archives."; exit 1 ;; esac""",
    "apt-cache": "",
    "bwrap": """
case $* in
*dpkg*) touch "$LOG.dpkg"; sleep ${DPKG_SECONDS:-0}; exit ${DPKG_STATUS:-0} ;;
*--chdir*) echo inside ;;
esac""",
    "dpkg-query": "exit 1",
    "mmdebstrap": 'tar -c -C "${LOG%/*}/debian" ./etc ./usr ./var',
    "newuidmap": "",
    "python": "exit 1",
    "python3": "exit 1",
}

Run = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Call `run` with a cache folder whose name has a space; `log` there has what it called."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, body in STAND_INS.items():
        (programs / name).write_text(f'#!/bin/sh\necho "{name} $*" >>"$LOG"\n{body}\n')
        (programs / name).chmod(0o755)
    for name in ("etc", "usr/bin", "var/lib/apt"):
        (tmp_path / "debian" / name).mkdir(parents=True)
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("CRMS")},
        "PATH": f"{programs}:/usr/bin:/bin",
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "a cache"),
        "LOG": str(tmp_path / "log"),
        "DISPLAY": ":0",
    }

    def start(*command: str, suite: str = "trixie", **more: str | int) -> subprocess.Popen[str]:
        given = {k: v for k, v in more.items() if isinstance(v, str)}
        stdin = more.get("terminal", subprocess.DEVNULL)
        return subprocess.Popen(
            [ROOT / "run", *command],
            stdin=int(stdin),
            stdout=subprocess.PIPE,
            stderr=int(more.get("terminal", subprocess.PIPE)),
            text=True,
            start_new_session=True,
            env={**environment, **({"CRMS_SUITE": suite} if suite else {}), **given},
        )

    return start


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Status and output of a process."""
    out, err = process.communicate(timeout=60)
    return process.returncode, out or "", err or ""


def called(folder: Path, words: str) -> list[str]:
    """Calls of stand-ins in which these words are."""
    return [line for line in (folder / "log").read_text().splitlines() if words in line]


def names(file: str) -> set[str]:
    """Packages of a list."""
    lines = (line.partition("#")[0].strip() for line in (ROOT / file).read_text().splitlines())
    return {line for line in lines if line}


def test_packages_are_added_to_the_environment_that_there_is(tmp_path: Path, run: Run) -> None:
    status, out, err = finish(run("true"))
    assert (status, out) == (0, "inside\n")
    assert "2.3 GB" in err and "go on?" not in err
    root = tmp_path / "a cache" / "crms_fenicsx" / "trixie"
    (root / "usr" / "kept").touch()
    status, out, err = finish(run("plot", "true"))
    assert (status, out) == (0, "inside\n")
    assert "run: Need to get 12 MB" in err
    assert len(called(tmp_path, "mmdebstrap")) == 1
    (download,) = called(tmp_path, "--download-only")
    assert set(download.partition(" install ")[2].split()) == names("packages_plot.txt")
    have = set((root / "packages").read_text().split())
    assert have == names("packages.txt") | names("packages_plot.txt")
    assert (root / "usr" / "kept").exists()
    finish(run("plot", "true"))
    assert len(called(tmp_path, "--download-only")) == 1


def test_an_environment_stays_as_it_was_if_packages_cannot_be_added(
    tmp_path: Path, run: Run
) -> None:
    finish(run("true"))
    status, out, err = finish(run("docs", DPKG_STATUS="1"))
    assert (status, out) == (1, "") and "stays as it was" in err
    root = tmp_path / "a cache" / "crms_fenicsx" / "trixie"
    assert set((root / "packages").read_text().split()) == names("packages.txt")
    assert sorted(p.name for p in root.parent.iterdir()) == ["trixie", "trixie.lock"]
    assert finish(run("true"))[:2] == (0, "inside\n")


def test_a_killed_run_leaves_an_environment_that_works(tmp_path: Path, run: Run) -> None:
    finish(run("true"))
    process = run("docs", DPKG_SECONDS="60")
    wait_for(tmp_path / "log.dpkg")
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert finish(run("true"))[:2] == (0, "inside\n")
    assert finish(run("docs"))[:2] == (0, "inside\n")
    root = tmp_path / "a cache" / "crms_fenicsx" / "trixie"
    assert set((root / "packages").read_text().split()) == (
        names("packages.txt") | names("docs/packages.txt")
    )
    assert sorted(p.name for p in root.parent.iterdir()) == ["trixie", "trixie.lock"]


def test_of_two_runs_at_once_one_adds_packages(tmp_path: Path, run: Run) -> None:
    finish(run("true"))
    first = run("docs", DPKG_SECONDS="0.5")
    wait_for(tmp_path / "log.dpkg")
    second = run("docs")
    assert [finish(one)[:2] for one in (first, second)] == 2 * [(0, "inside\n")]
    assert len(called(tmp_path, "--download-only")) == 1


def test_a_question_is_asked_on_a_terminal(tmp_path: Path, run: Run) -> None:
    ours, theirs = pty.openpty()
    os.write(ours, b"n\n")
    status, out, _ = finish(run("true", terminal=theirs))
    said = ""
    while "go on?" not in said and select.select([ours], [], [], 5.0)[0]:
        said += os.read(ours, 10000).decode()
    assert (status, out) == (1, "") and "go on? [Y/n]" in said
    assert not called(tmp_path, "mmdebstrap")
    os.write(ours, b"\n")
    assert finish(run("true", terminal=theirs))[:2] == (0, "inside\n")
    os.close(ours)
    os.close(theirs)


def test_apt_adds_packages_to_its_own_dolfinx(tmp_path: Path, run: Run) -> None:
    if "dolfinx" not in subprocess.run(
        ["/usr/bin/python3", "-c", "import dolfinx; print(dolfinx)"],
        capture_output=True, text=True, check=False,
    ).stdout:  # fmt: skip
        pytest.skip("this DOLFINx is not apt's")
    assert finish(run("plot", "echo", "ran", suite=""))[:2] == (0, "ran\n")
    (install,) = called(tmp_path, " -qq -y ")
    assert set(install.partition(" install ")[2].split()) >= names("packages_plot.txt")
    assert finish(run("echo", "ran", suite=""))[:2] == (0, "ran\n")
    assert len(called(tmp_path, " -qq -y ")) == 1


def wait_for(path: Path) -> None:
    """Until a file is there."""
    end = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.02)
