"""What every test shares: no thread may outlive its test, and real pictures are found or the test skips."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import settings

import stadimeter  # noqa: F401 - before OpenCV, which asks only once how many pixels it may decode
from stadimeter.app import ending
from support.programs import left_out

# Machines are shared and slow at times: how long an example takes says nothing. The examples are the same everywhere
# and each time, so that a change is judged by what it changes and a newcomer sees what CI saw; only `make nightly`
# draws new ones, many, and prints how to repeat those that failed.
settings.register_profile("here", deadline=None, derandomize=True, max_examples=60)
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=10)  # `make quick`
settings.register_profile("nightly", deadline=None, max_examples=1000, print_blob=True)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE") or "here"
settings.load_profile(PROFILE)

# Programs that tests start find `support` as well.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))

# Progress is shown of what takes longer than half a second: on a busy machine, of anything. Its own tests turn it on.
os.environ["STADIMETER_PROGRESS"] = "off"

# Nor does what the terminal of whoever starts the tests is like change what programs show, or how soon.
for _name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "PYTHONUNBUFFERED"):
    os.environ.pop(_name, None)

# Programs that tests start inherit what becomes of a hangup, of Ctrl-C and the like; `nohup make test &` must not
# change what they see.
for _number in (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
    signal.signal(_number, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)

REAL_PICTURES = Path(__file__).resolve().parents[2] / "shared" / "data"


# These start programs and wait for them. They begin first: else one worker waits at the end when the others are done.
WAITING = ("web", "cli", "scenario", "messaging", "contract", "workbench", "app")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the folders, and fit hypothesis's settings of single tests to the profile."""
    folder = Path(__file__).parent
    items.sort(key=lambda item: item.path.relative_to(folder).parts[0] not in WAITING)
    if PROFILE != "here":
        _fit_examples(items)


def _fit_examples(items: list[pytest.Item]) -> None:
    """Give tests that state settings of their own fewer examples in the profile `quick`, and more in `nightly`."""
    for item in items:
        test = getattr(item, "obj", None)
        test = getattr(test, "__func__", test)  # of a method, the function that bears the settings
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None:
            examples = (min if PROFILE == "quick" else max)(own.max_examples, settings.default.max_examples)
            test._hypothesis_internal_use_settings = settings(
                own, max_examples=examples, derandomize=settings.default.derandomize
            )


def pytest_unconfigure(config: pytest.Config) -> None:
    """Say last how many tests were left out for want of programs, and how to have them."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or hasattr(config, "workerinput"):
        return
    skipped = [report.longrepr for report in reporter.stats.get("skipped", [])]
    if line := left_out([str(each[2]) for each in skipped if isinstance(each, tuple)]):
        reporter.write_line(line)


@pytest.fixture
def closing() -> Iterator[ExitStack]:
    """Return what closes everything in the end, last first."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture(autouse=True, scope="session")
def no_last_resort() -> None:
    """Keep a run in the process of the tests from ending that process where a busy machine is late to close things."""
    ending.LAST_RESORT_S = 600.0


def pool_of(thread: threading.Thread) -> str | None:
    """Return the pool that a thread works for, by the names that asyncio and anyio give; None for any other thread.

    A server that several tests share starts one more worker whenever two requests happen to overlap, which is more
    often on a busy machine; the pool ends with the server.
    """
    if thread.name.startswith("AnyIO worker thread"):
        return "AnyIO worker thread"
    pool, _, number = thread.name.rpartition("_")
    return pool if pool and number.isdigit() else None


@pytest.fixture(autouse=True)
def no_thread_left_behind() -> Iterator[None]:
    """Fail a test that leaves a thread running. One that is about to end is waited for, however busy the machine is."""
    before = set(threading.enumerate())
    pools = set(filter(None, map(pool_of, before)))
    yield
    deadline_s = time.monotonic() + 60.0
    left = [thread for thread in threading.enumerate() if thread not in before and pool_of(thread) not in pools]
    for thread in left:
        thread.join(max(0.0, deadline_s - time.monotonic()))
    assert not [thread.name for thread in left if thread.is_alive()]


@pytest.fixture(scope="session")
def real_pictures() -> Path:
    """Return the folder of real pictures with known distances; skip where there is none."""
    if not REAL_PICTURES.is_dir():
        pytest.skip("the real pictures are not on this machine: no folder shared/data beside the checkout")
    return REAL_PICTURES
