"""Fixtures that all tests share, and the rule which tests run under mpirun."""

from collections.abc import Iterator

import pytest
from mpi4py import MPI

from crms_fenicsx.runtime import errors


@pytest.fixture(scope="session")
def comm() -> MPI.Intracomm:
    """All ranks. A test that has it runs on any number of them, and every other on one only."""
    return MPI.COMM_WORLD


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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Under mpirun, skip what does not use `comm`: each rank would do the same once more."""
    if MPI.COMM_WORLD.size > 1:
        skip = pytest.mark.skip(reason="nothing in it is distributed")
        for item in items:
            if "comm" not in getattr(item, "fixturenames", ()):
                item.add_marker(skip)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """A test that fails on one rank only ends all, as the others may wait in it for ever."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    if report.failed and not errors.all_failed(MPI.COMM_WORLD):
        capture = item.config.pluginmanager.getplugin("capturemanager")
        with capture.global_and_fixture_disabled():
            errors.end_all(MPI.COMM_WORLD, report.longreprtext, item.nodeid)
