"""Fixtures that all tests share, and the rule which tests run under mpirun."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mpi4py import MPI

from crms_fenicsx.foundation.runtime import errors


@pytest.fixture(scope="session")
def comm() -> MPI.Intracomm:
    """All ranks. A test that has it passes on any number of them, and every other runs on one."""
    return MPI.COMM_WORLD


@pytest.fixture
def folder(comm: MPI.Intracomm, tmp_path: Path) -> Path:
    """A folder that all ranks have in common."""
    return Path(comm.bcast(str(tmp_path)))


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Run the whole suite on all cores where pytest-xdist is there, but not on each of many ranks.

    Its own options, as `-n 0`, come first; `--pdb` stays in one process.
    """
    option = config.option
    if (
        config.pluginmanager.hasplugin("xdist")
        and not hasattr(config, "workerinput")  # a worker: it must start no workers itself
        and MPI.COMM_WORLD.size == 1
        and not option.file_or_dir
        and option.numprocesses is None
        and option.dist == "no"
    ):
        option.numprocesses, option.dist = "auto", "worksteal"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let all tests that can run under mpirun."""
    help_text = "under mpirun, run all tests that have `comm`, and not only those marked `ranks`"
    parser.addoption("--all-ranks", action="store_true", help=help_text)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Under mpirun, skip what says nothing about ranks: each rank would do the same once more.

    Of tests marked `ranks` the first and the last case run, of which there may be many. What is
    marked `slow` runs where a `-m` or a test's own name asks for it.
    """
    if MPI.COMM_WORLD.size > 1:
        cases: dict[str, list[pytest.Item]] = {}
        for item in items:
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
        ends = {id(item) for found in cases.values() for item in (found[0], found[-1])}
        skip = pytest.mark.skip(reason="it says nothing about ranks")
        for item in items:
            chosen = item.get_closest_marker("ranks") is not None and id(item) in ends
            if "comm" not in getattr(item, "fixturenames", ()) or not (
                chosen or config.option.all_ranks
            ):
                item.add_marker(skip)
    if not config.option.markexpr and not any("::" in given for given in config.args):
        slow = [item for item in items if item.get_closest_marker("slow") is not None]
        items[:] = [item for item in items if item.get_closest_marker("slow") is None]
        config.hook.pytest_deselected(items=slow)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """A test that fails on one rank only ends all, as the others may wait in it for ever."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    if report.failed and not errors.all_failed(MPI.COMM_WORLD):
        capture = item.config.pluginmanager.getplugin("capturemanager")
        with capture.global_and_fixture_disabled():
            errors.end_all(MPI.COMM_WORLD, report.longreprtext, item.nodeid)
