"""Lets tests import the modules of the benchmarks, which are scripts rather than a package."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def benchmarks_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``import samples`` and the like find this folder."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
