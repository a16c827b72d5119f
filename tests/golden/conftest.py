"""The option that writes golden files anew."""

from __future__ import annotations

import pytest

from support.golden import Golden

OPTION = "--write-golden"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, action="store_true", help="write the golden files anew in place of comparing with them")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Return the golden files."""
    return Golden(is_written=request.config.getoption(OPTION, default=False))
