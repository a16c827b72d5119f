"""Things that may be missing beside the program: libraries of extras, with the line that installs them, and guides."""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec
from pathlib import Path

from stadimeter.errors import DriverUnavailableError

# The library of each extra, by the extra's name.
LIBRARIES = {
    "metrics": "prometheus_client",
    "network": "onnxruntime",
    "notify": "apprise",
    "pi": "lgpio",
    "record": "mcap",
    "ros2": "websockets",
    "sun": "astral",
    "tof": "VL53L1X",
    "web": "uvicorn",
}

# The first version that can give up waiting for a camera (`cancel_all_and_flush`).
OLDEST_PICAMERA2 = "0.3.20"
PICAMERA2_TOO_OLD = (
    f"this picamera2 is too old: before {OLDEST_PICAMERA2} it cannot give up waiting for a camera; `sudo apt update &&"
    " sudo apt full-upgrade`"
)

# Where apt puts libraries, which a Python environment of its own does not see.
SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")

# What pip has to install beside libraries from apt that were built for numpy 1, as on Raspberry Pi OS 12.
NUMPY_1 = "'numpy<2' 'opencv-python-headless<4.12'"


# Where the Debian package has its environment, which has no pip and sees the system's packages.
PACKAGED = "/opt/stadimeter"

# No repository has it, so apt needs the file.
PACKAGE_AGAIN = "`sudo apt install --reinstall ./stadimeter_VERSION.deb`, the package's file"

# What Debian has. The package brings the libraries of the other extras itself, but for these: few need them, and some
# are large, or are compiled where they are installed. The package index has them by the names of `LIBRARIES`.
_OF_DEBIAN = {"pi": "python3-lgpio"}
NOT_IN_PACKAGE = frozenset({"network", "notify", "ros2", "tof"})

# From this Python on the package index has no wheel of lgpio, and its source does not build without more.
WITHOUT_LGPIO = (3, 13)

# Where the guides are that messages name: in a checkout, in the Debian package (a system may leave them out by
# `path-exclude` of dpkg), or on the web.
GUIDES_OF_CHECKOUT = Path(__file__).parents[3] / "docs"
GUIDES_OF_PACKAGE = Path("/usr/share/doc/stadimeter")
GUIDES_ON_THE_WEB = "https://github.com/stadimeter/stadimeter/blob/main/docs"


def install_line(extra: str) -> str:
    """Return the command that installs an extra for the Python that runs, which need not be the first of the path."""
    is_packaged = sys.prefix.startswith(PACKAGED)
    if extra in _OF_DEBIAN and (is_packaged or sys.version_info >= WITHOUT_LGPIO):
        return of_system(_OF_DEBIAN[extra])
    if not is_packaged:
        return f"{shlex.quote(sys.executable)} -m pip install 'stadimeter[{extra}]'"
    if extra in NOT_IN_PACKAGE:
        pip = f"sudo python3 -m pip install --target {PACKAGED}/drivers"
        return f"sudo apt install python3-pip && {pip} {LIBRARIES[extra]}"
    return PACKAGE_AGAIN.replace("`", "")


def of_system(package: str) -> str:
    """Return the command that installs a library of the system's packages, and lets this environment see it."""
    is_seen = sys.prefix.startswith(PACKAGED) or str(SYSTEM_PACKAGES) in sys.path
    # Anew in its place; where this Python is in no environment, beside it, or venv would replace that Python.
    own = shlex.quote(sys.prefix) if sys.prefix != sys.base_prefix else "~/stadimeter-env"
    see = "" if is_seen else f" && python3 -m venv --system-site-packages {own}"
    return f"sudo apt install {package}{see}"


def missing(extra: str) -> str:
    """Return a sentence if the library of an extra is not installed, with the line that installs it; else nothing."""
    library = LIBRARIES[extra]
    return "" if find_spec(library) else f"the library {library} is not installed: run {install_line(extra)}"


def require(extra: str, what: str) -> None:
    """Make sure that the library of an extra is installed, before any work that would be lost without it.

    Args:
        what: What needs it.

    Raises:
        DriverUnavailableError: It is not.
    """
    if trouble := missing(extra):
        raise DriverUnavailableError(f"{what} needs a library: {trouble}")


def guide(page: str) -> str:
    """Return where a page such as ``troubleshooting.md`` can be read from this computer."""
    if (GUIDES_OF_CHECKOUT / page).is_file():
        return f"docs/{page}"
    if (GUIDES_OF_PACKAGE / page).is_file():
        return str(GUIDES_OF_PACKAGE / page)
    return f"{GUIDES_ON_THE_WEB}/{page}"
