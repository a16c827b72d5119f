"""Programs beside Python that tests use, and Debian's packages that bring them. Without one, its tests are skipped."""

from __future__ import annotations

import re
import shutil

import pytest

PACKAGES = {
    "chromium": "chromium",
    "debootstrap": "debootstrap",
    "dpkg-deb": "dpkg",
    "ffmpeg": "ffmpeg",
    "gcc": "gcc",
    "git": "git",
    "mosquitto": "mosquitto",
    "mosquitto_passwd": "mosquitto",
    "mosquitto_rr": "mosquitto-clients",
    "openssl": "openssl",
    "pdftoppm": "poppler-utils",
    "prometheus": "prometheus",
    "promtool": "prometheus",
    "shellcheck": "shellcheck",
    "strace": "strace",
    "systemd-analyze": "systemd",
    "unshare": "util-linux",
}

_INSTALL = "sudo apt install"
_REMEDY = re.compile(rf"{_INSTALL} ([a-z0-9 +.-]+)$")


def path_of(program: str) -> str | None:
    """Return the path of a program, or None. Servers are found too, whose folder is not on an ordinary user's path."""
    return shutil.which(program) or shutil.which(program, path="/usr/sbin:/usr/local/sbin:/sbin")


def why_missing(*programs: str) -> str:
    """Return which of the programs are not installed and how to have them; empty if all are."""
    absent = [program for program in programs if path_of(program) is None]
    packages = " ".join(dict.fromkeys(PACKAGES[program] for program in absent))
    return f"not installed: {', '.join(absent)}; {_INSTALL} {packages}" if absent else ""


def needs(*programs: str) -> pytest.MarkDecorator:
    """Mark a test that is skipped where one of the programs is missing."""
    return pytest.mark.skipif(bool(why_missing(*programs)), reason=why_missing(*programs) or "all are installed")


def require(*programs: str) -> None:
    """Skip the running test where one of the programs is missing."""
    if why := why_missing(*programs):
        pytest.skip(why)


def packages_in(reason: str) -> list[str]:
    """Return the packages that a reason for a skip names; none if it was for something else."""
    found = _REMEDY.search(reason)
    return found.group(1).split() if found else []


def left_out(reasons: list[str]) -> str:
    """Return one line on the tests that were skipped for want of programs, from all reasons; empty if none were."""
    wanting = [packages for packages in map(packages_in, reasons) if packages]
    if not wanting:
        return ""
    names = " ".join(sorted({name for packages in wanting for name in packages}))
    were = "test was" if len(wanting) == 1 else "tests were"
    return f"{len(wanting)} {were} left out for want of programs. To have them: {_INSTALL} {names}"
