"""What tests of the page share: a browser for each file of tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a real Chromium; skip where there is none."""
    with chromium() as started:
        yield started


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give the tests of the page more time than others, where they name none, and count those in a browser as long."""
    for item in items:
        if Path(__file__).parent not in item.path.parents:
            continue
        if item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(180))
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.long)
