"""Libraries that come with an extra of this package: whether one is there, and the line that installs it."""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec

from stadimeter.errors import DriverUnavailableError

LIBRARIES = {"notify": "apprise", "pi": "lgpio", "plots": "matplotlib", "record": "mcap", "tags": "pyapriltags"}
"""The library of each extra, by the extra's name."""


def install_line(extra: str) -> str:
    """Return the command that installs an extra for the Python that runs, which need not be the first of the path."""
    return f"{shlex.quote(sys.executable)} -m pip install 'stadimeter[{extra}]'"


def missing(extra: str) -> str:
    """Return a sentence if the library of an extra is not installed, with the line that installs it; else nothing."""
    library = LIBRARIES[extra]
    return "" if find_spec(library) else f"the library {library} is not installed: run {install_line(extra)}"


def require(extra: str, what: str, otherwise: str = "") -> None:
    """Make sure that the library of an extra is installed, before any work that would be lost without it.

    Args:
        what: What needs it.
        otherwise: What to do instead, such as ``leave out --plot``.

    Raises:
        DriverUnavailableError: It is not.
    """
    if trouble := missing(extra):
        raise DriverUnavailableError(f"{what} needs a library: {trouble}{f', or {otherwise}' if otherwise else ''}")
