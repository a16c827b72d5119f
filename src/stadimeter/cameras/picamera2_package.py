"""The packages picamera2 and libcamera, which only a Raspberry Pi has: loading them, their cameras, their errors."""

from __future__ import annotations

import logging
import os
import re
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stadimeter.cameras.attached_devices import in_use
from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.config.extras import (
    NUMPY_1,
    OLDEST_PICAMERA2,
    PACKAGE_AGAIN,
    PACKAGED,
    PICAMERA2,
    PICAMERA2_TOO_OLD,
    PICAMERA2_UNSEEN,
    SEE_SYSTEM,
)
from stadimeter.errors import DriverUnavailableError, StadimeterError

SYSTEM_PACKAGES = Path(PICAMERA2_UNSEEN).parent
DEVICES = ("/dev/media*", "/dev/video*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Package:
    """What is used of the packages picamera2 and libcamera.

    Attributes:
        Picamera2: The class of cameras.
        MappedArray: Shows the buffer of a request as an array, without a copy.
        Transform: How pictures are turned.
        controls: The enumerations of control values.
    """

    Picamera2: Any
    MappedArray: Any
    Transform: Any
    controls: Any


def load_package() -> Package:
    """Import picamera2, which takes a second and is only there on a Raspberry Pi.

    Raises:
        DriverUnavailableError: It is not there, or does not fit this environment.
    """
    # Both write to the terminal what they do and what went wrong, which our errors say, unless this says otherwise.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:ERROR")
    logging.getLogger("picamera2").addHandler(logging.NullHandler())
    try:
        import libcamera  # noqa: PLC0415 - only a Raspberry Pi has it
        import picamera2  # noqa: PLC0415
    except ImportError as error:
        raise DriverUnavailableError(lack() or f"picamera2 cannot be loaded: {error}") from error
    except Exception as error:  # a package that was built for another numpy fails with a ValueError
        mend = f"where the system's packages are for numpy 1, run `pip install {NUMPY_1}`"
        remedy = PACKAGE_AGAIN if sys.prefix.startswith(PACKAGED) else mend
        raise DriverUnavailableError(f"picamera2 does not fit this environment: {error}; {remedy}") from error
    if not hasattr(picamera2.Picamera2, "cancel_all_and_flush"):
        raise DriverUnavailableError(PICAMERA2_TOO_OLD)
    return Package(
        Picamera2=picamera2.Picamera2,
        MappedArray=picamera2.MappedArray,
        Transform=libcamera.Transform,
        controls=libcamera.controls,
    )


def lack() -> str:
    """Return why picamera2 cannot be loaded here, in a sentence, or an empty string; loads nothing."""
    if find_spec("picamera2") is not None:
        if find_spec("libcamera") is not None:
            return PICAMERA2_TOO_OLD if is_too_old() else ""
        return f"picamera2 is there without libcamera, which pip does not have: {PICAMERA2}, and {SEE_SYSTEM}"
    if (SYSTEM_PACKAGES / "picamera2").is_dir():
        return f"picamera2 is installed, but not seen from this Python environment: {SEE_SYSTEM}"
    anew = "" if str(SYSTEM_PACKAGES) in sys.path else f", and {SEE_SYSTEM}"
    return f"the library picamera2 is not installed: {PICAMERA2}{anew}"


def is_too_old() -> bool:
    """Return whether the installed picamera2 says that it is too old for us; loads nothing."""
    try:
        numbers = re.findall(r"\d+", version("picamera2"))
    except PackageNotFoundError:  # loading it will show
        return False
    return [int(each) for each in numbers[:3]] < [int(each) for each in OLDEST_PICAMERA2.split(".")]


def why(error: BaseException) -> str:
    """Return what happened, in one line. Picamera2 hides the cause behind one sentence for everything."""
    root: BaseException = error
    while (before := root.__cause__ or root.__context__) and not isinstance(before, StadimeterError):
        root = before
    words = " ".join(str(root).split()) or type(root).__name__
    if "busy" in words.lower() or "acquire" in words.lower():
        return f"{in_use(*DEVICES)} (libcamera says: {words})"
    return words


def attached_cameras() -> tuple[AttachedCamera, ...]:
    """Return the cameras on ribbon cables; none without the packages. USB cameras are left to the driver ``opencv``."""
    try:
        package = load_package()
    except DriverUnavailableError:
        return ()
    found = enumerate(package.Picamera2.global_camera_info())
    return tuple(_as_attached(number, each) for number, each in found if "usb" not in each.get("Id", "").lower())


def _as_attached(number: int, found: dict[str, Any]) -> AttachedCamera:
    path = str(found.get("Id", number))
    name = str(found.get("Model", "unknown"))
    return AttachedCamera(driver="picamera2", options={"camera": path}, path=path, name=name, node=f"camera {number}")
