"""A plugin of pytest that runs the tests named in a file, in their order. `mutants` uses it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests that the file names."""
    order = {name: place for place, name in enumerate(json.loads(Path(os.environ["CHOSEN"]).read_text()))}
    items[:] = sorted((item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid])
