"""Whether the libraries that read pictures load together: tried in another Python, which may crash or hang."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from stadimeter.config.extras import NUMPY_1, PACKAGE_AGAIN, PACKAGED, PICAMERA2, PICAMERA2_TOO_OLD, SEE_SYSTEM
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.doctor.diagnosis import Diagnosis, fine, unknown, wrong

IMPORT_S = 15.0
LIBRARIES = ("numpy", "cv2", "simplejpeg", "pydantic", "picamera2")
OPTIONAL = ("picamera2", "lgpio")
"""Of these, lgpio is looked for and not imported: it leaves a named pipe in the working directory."""

PROBE = """
import importlib, importlib.util, json, sys
bits = 64 if sys.maxsize > 2**32 else 32
print(json.dumps({"python": sys.version.split()[0], "bits": bits, "prefix": sys.prefix, "runs": sys.executable}))
for name in sys.argv[1:]:
    spec = importlib.util.find_spec(name)
    found = {"name": name, "version": "", "file": str(spec and spec.origin), "error": "", "missing": spec is None}
    if spec is not None and name != "lgpio":
        print(json.dumps({"trying": name}), flush=True)
        try:
            module = importlib.import_module(name)
            found["version"] = str(getattr(module, "__version__", ""))
            if name == "picamera2" and not hasattr(module.Picamera2, "cancel_all_and_flush"):
                found["error"] = "too old"
        except BaseException as error:
            found["error"] = f"{type(error).__name__}: {error}"
    print(json.dumps(found), flush=True)
"""
"""Prints a line of JSON on the Python, one before each library and one after it; what crashes leaves out the latter."""

_NUMPY_MIX = re.compile(
    r"dtype size changed|compiled (?:using|against) (?:NumPy|API)|_ARRAY_API|multiarray", re.IGNORECASE
)
"""What an extension says that was built for another major version of numpy."""


def python_command() -> tuple[str, ...]:
    """Return the command that runs the Python of this environment, as the one that runs now was begun."""
    return (sys.executable, "-s") if sys.flags.no_user_site else (sys.executable,)


@dataclass(frozen=True, slots=True)
class Imports:
    """What importing the libraries in another Python printed, line by line, and whether it ended in time."""

    lines: list[dict[str, Any]]
    is_late: bool = False

    def lacks(self, name: str) -> bool:
        """Return whether a library is not seen from this environment."""
        return any(line.get("name") == name and line["missing"] for line in self.lines)


def import_libraries(computer: Computer) -> Imports:
    """Import the libraries in another Python."""
    answer = computer.run((*python_command(), "-c", PROBE, *LIBRARIES, "lgpio"), IMPORT_S)
    if answer is None:
        return Imports([])
    lines = [json.loads(line) for line in answer.output.splitlines() if line.startswith("{")]
    return Imports(lines, answer.code is None)


def libraries(imports: Imports) -> Iterator[Diagnosis]:
    """Tell which libraries load, with their versions and where each comes from, and what keeps one from it."""
    lines = imports.lines
    if not lines:
        yield unknown("Python could not be started anew, so the libraries were not tried")
        return
    python, found = lines[0], [line for line in lines if "name" in line]
    if python["bits"] == 32:
        yield wrong("this is a 32-bit system", "install the 64-bit Raspberry Pi OS: OpenCV is to be had for that only")
    yield from (_broken(each, python, found) for each in found if each["error"])
    missing = [each["name"] for each in found if each["missing"] and each["name"] not in OPTIONAL]
    if missing:
        yield wrong(f"{' and '.join(missing)} is not installed", _again(python))
    if (untried := _stopped_at(lines)) is not None:
        how = "takes too long" if imports.is_late else "crashes Python"
        yield wrong(f"importing {untried} {how}", _again(python))
    if not (missing or untried or any(each["error"] for each in found)):
        loaded = (each for each in found if each["name"] in LIBRARIES and not each["missing"])
        names = ", ".join(f"{each['name']} {each['version']}".strip() + _origin(each) for each in loaded)
        yield fine(f"Python {python['python']} in {python['prefix']}; {names} load together")


def _stopped_at(lines: list[dict[str, Any]]) -> str | None:
    return lines[-1].get("trying")


def _origin(library: dict[str, Any]) -> str:
    return " (apt)" if "/dist-packages/" in library["file"] else ""


def _broken(library: dict[str, Any], python: dict[str, Any], found: list[dict[str, Any]]) -> Diagnosis:
    if library["error"] == "too old":
        return wrong(*PICAMERA2_TOO_OLD.split("; "))
    if not _NUMPY_MIX.search(library["error"]):
        is_of_pi = library["name"] == "picamera2"  # what it needs is not on pip
        is_packaged = python["prefix"].startswith(PACKAGED)
        of_pi = PICAMERA2 if is_packaged else f"{PICAMERA2}, and {SEE_SYSTEM}"
        remedy = of_pi if is_of_pi else _again(python, library["name"])
        return wrong(f"{library['name']} does not load: {_short(library['error'])}", remedy)
    numpy = next((each for each in found if each["name"] == "numpy"), None)
    beside = f" beside numpy {numpy['version']}{_origin(numpy)}" if numpy and numpy["version"] else ""
    seen = f"{library['name']} does not load{beside}: it was built for another numpy ({_short(library['error'])})"
    is_of_apt = _origin(library) and not python["prefix"].startswith(PACKAGED)
    return wrong(seen, f"{_pip(python)} {NUMPY_1}" if is_of_apt else _again(python, library["name"]))


def _short(error: str) -> str:
    return " ".join(error.split())[:160]


def _again(python: dict[str, Any], library: str = "stadimeter") -> str:
    if python["prefix"].startswith(PACKAGED):
        return PACKAGE_AGAIN
    return f"{_pip(python)} --force-reinstall {library}"


def _pip(python: dict[str, Any]) -> str:
    return f"{shlex.quote(python['runs'])} -m pip install"
