"""The comparison with a peer's reading of part programs: only with `--programs FOLDER`, for they are not part of this.

FOLDER holds pairs of `NAME.ngc` and `NAME.canon`, what another interpreter (LinuxCNC's `rs274 -g`) made of it.
"""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--programs", metavar="FOLDER", type=Path, help="folder of NAME.ngc with NAME.canon beside it")


def pytest_ignore_collect(config: pytest.Config) -> bool | None:
    return True if config.getoption("--programs", default=None) is None else None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "program" in metafunc.fixturenames:
        programs = sorted(metafunc.config.getoption("--programs").glob("*.ngc"))
        metafunc.parametrize("program", programs, ids=lambda path: path.stem)


@pytest.fixture(scope="session")
def programs(pytestconfig: pytest.Config) -> list[Path]:
    return sorted(pytestconfig.getoption("--programs").glob("*.ngc"))
