"""Cycles of the loop made by hand, for the tests of the views."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.app.cycle import CycleRecord
from stadimeter.core.measurement import Track
from support.cycle_records import cycle_record, tracked


@pytest.fixture
def make_track() -> Callable[..., Track]:
    """Return a function that makes a track of a ball at 2.43 m, with whatever is named changed."""
    return tracked


@pytest.fixture
def make_record() -> Callable[..., CycleRecord]:
    """Return a function that makes a cycle with three outputs and five rules, with whatever is named changed."""
    return cycle_record
