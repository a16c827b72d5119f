"""A plugin of pytest for `make test-sample`: of the long tests as many as some minutes hold, others for each commit.

Those of the folders that the change touches come first, then the rest in an order that the commit's hash draws. What
has not begun when the minutes are over is left for other commits; `make nightly` runs all.
"""

from __future__ import annotations

import random
import subprocess
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LEFT = "left for another commit: the time for long tests is over"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Take how long tests may begin."""
    parser.addoption("--minutes", type=float, default=10.0, help="no long test begins later than this")


def pytest_configure(config: pytest.Config) -> None:
    """Note when the tests begin; it is a process of its own that does so, for each worker."""
    config.stash[_ENDS_S] = time.monotonic() + 60.0 * config.getoption("minutes")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the files of tests; the tests of a file stay together and in their order."""
    files = sorted({item.path for item in items})
    random.Random(_git("rev-parse", "HEAD")).shuffle(files)  # noqa: S311 - the same for each worker and each repetition
    touched = touched_rooms(_git("diff", "--name-only", _base(), "HEAD").split())
    files.sort(key=lambda file: file.relative_to(ROOT).parts[1] not in touched)
    place = {file: number for number, file in enumerate(files)}
    items.sort(key=lambda item: place[item.path])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave out what begins too late."""
    if time.monotonic() > item.config.stash[_ENDS_S]:
        pytest.skip(LEFT)


def touched_rooms(changed: list[str]) -> set[str]:
    """Return the folders of tests that a change is about: those of its tests, and those that test its source."""
    parts = [Path(name).parts for name in changed]
    tests = {part[1] for part in parts if part[0] == "tests" and len(part) > 2}
    source = {part[2] for part in parts if part[:2] == ("src", "stadimeter") and len(part) > 3}
    others = {part[0] for part in parts if part[0] in {"deploy", "docs"}}
    return tests | source | others


_ENDS_S = pytest.StashKey[float]()


def _git(*words: str) -> str:
    """Return what git answers; nothing where there is no such commit, as in a shallow clone."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


def _base() -> str:
    """Return what the change begins from: where it left the main branch; on that branch, the commit before."""
    base = _git("merge-base", "origin/main", "HEAD")
    return base if base and base != _git("rev-parse", "HEAD") else "HEAD~1"
