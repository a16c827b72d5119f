"""What tests of the page share: a browser for each file of tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a real Chromium; skip where there is none."""
    with chromium() as started:
        yield started
