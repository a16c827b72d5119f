"""Libraries that come with an extra of this package: whether one is there, and the line that installs it."""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec

from stadimeter.errors import DriverUnavailableError

LIBRARIES = {
    "notify": "apprise",
    "pi": "lgpio",
    "plots": "matplotlib",
    "record": "mcap",
    "tags": "pyapriltags",
    "web": "uvicorn",
}
"""The library of each extra, by the extra's name."""

PICAMERA2 = "`sudo apt install python3-picamera2`"
PICAMERA2_UNSEEN = "/usr/lib/python3/dist-packages/picamera2"
"""Where apt puts it, which a Python environment of its own does not see."""
SEE_SYSTEM = (
    "make the environment anew with `python3 -m venv --system-site-packages`, so that it sees the system's packages"
)
NUMPY_1 = "'numpy<2' 'opencv-python-headless<4.12'"
"""What pip has to install beside libraries from apt that were built for numpy 1, as on Raspberry Pi OS 12."""


PACKAGED = "/opt/stadimeter"
"""Where the Debian package has its environment, which has no pip and sees the system's packages."""

_OF_DEBIAN = {"pi": "python3-lgpio", "plots": "python3-matplotlib"}


def install_line(extra: str) -> str:
    """Return the command that installs an extra for the Python that runs, which need not be the first of the path."""
    if sys.prefix.startswith(PACKAGED) and extra in _OF_DEBIAN:
        return f"sudo apt install {_OF_DEBIAN[extra]}"
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
