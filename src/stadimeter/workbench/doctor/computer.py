"""Facts of a computer, and findings about them.

Files are read below a root and commands are run through a function, so that tests put captured texts in their place.
Whether the libraries that read pictures load together is tried in another Python, which may crash or hang.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from stadimeter.app.clock import is_synchronised
from stadimeter.config.extras import NUMPY_1, PACKAGE_AGAIN, PACKAGED, PICAMERA2, PICAMERA2_TOO_OLD, SEE_SYSTEM
from stadimeter.errors import ConfigError, Problem, StadimeterError

if TYPE_CHECKING:  # reading a configuration loads the libraries that may be broken
    from stadimeter.config.loader import Configuration


class DiagnosisSeverity(StrEnum):
    """Severity of a diagnosis. What cannot be found out is `UNKNOWN`, never fine."""

    FINE = "fine"
    WARNING = "warning"
    WRONG = "wrong"
    UNKNOWN = "not known"


class Diagnosis(Struct, frozen=True):
    """The finding of a check.

    Attributes:
        seen: A phrase without a full stop.
        remedy: What to do about it; empty where there is nothing to do.
    """

    severity: DiagnosisSeverity
    seen: str
    remedy: str = ""


def fine(seen: str) -> Diagnosis:
    """Return that all is well."""
    return Diagnosis(DiagnosisSeverity.FINE, seen)


def warning(seen: str, remedy: str) -> Diagnosis:
    """Report what may become a problem."""
    return Diagnosis(DiagnosisSeverity.WARNING, seen, remedy)


def wrong(seen: str, remedy: str) -> Diagnosis:
    """Report what is wrong."""
    return Diagnosis(DiagnosisSeverity.WRONG, seen, remedy)


def unknown(seen: str, remedy: str = "") -> Diagnosis:
    """Report what cannot be found out here."""
    return Diagnosis(DiagnosisSeverity.UNKNOWN, seen, remedy)


COMMAND_S = 4.0


class CommandResult(Struct, frozen=True):
    """The output of a command before it ended; `code` is None if it was stopped since it took too long."""

    code: int | None
    output: str
    error: str = ""


def run_command(words: Sequence[str], limit_s: float = COMMAND_S) -> CommandResult | None:
    """Run a command without a shell and without input; None where it is not installed."""
    try:
        done = subprocess.run(  # noqa: S603 - our own words
            words, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired as late:
        return CommandResult(None, _text(late.stdout), _text(late.stderr))
    except OSError:
        return None
    return CommandResult(done.returncode, _text(done.stdout), _text(done.stderr))


def _text(printed: bytes | None) -> str:
    return (printed or b"").decode("utf-8", "replace")


class Computer(Struct, frozen=True, kw_only=True):
    """Access to everything that the checks may ask.

    Attributes:
        root: Where ``/proc``, ``/sys``, ``/etc`` and ``/boot`` are found.
        run: Runs a command within a time limit in seconds; None where it is not installed.
        is_clock_right: Whether the clock is synchronised.
        free_bytes: The free space of the file system that a path is on; raises `OSError`.
    """

    root: Path = Path("/")
    run: Callable[[Sequence[str], float], CommandResult | None] = run_command
    is_clock_right: Callable[[], bool] = is_synchronised
    free_bytes: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free

    def has(self, path: str) -> bool:
        """Check whether there is such a file or folder."""
        return os.path.lexists(self._at(path))

    def text(self, path: str) -> str:
        """Return the text of a file without spaces around it; ``""`` where it cannot be read."""
        try:
            return self._at(path).read_text("utf-8", "replace").strip("\0 \n")
        except OSError:
            return ""

    def paths(self, pattern: str) -> list[str]:
        """List the paths that fit a pattern such as ``/dev/gpiochip*``, sorted."""
        return sorted(f"/{found.relative_to(self.root)}" for found in self.root.glob(pattern.lstrip("/")))

    def node(self, path: str) -> str:
        """Return the name of the device that a path such as ``/dev/serial0`` leads to."""
        return self._at(path).resolve().name

    def prints(self, *words: str) -> str:
        """Return the output of a command, or ``""`` where it fails or is not installed."""
        answer = self.run(words, COMMAND_S)
        return answer.output.strip() if answer is not None and answer.code == 0 else ""

    @property
    def model(self) -> str:
        """The board, such as ``Raspberry Pi 5 Model B Rev 1.0``; empty where the firmware names none."""
        return self.text("/proc/device-tree/model")

    @property
    def is_pi(self) -> bool:
        """True if this is a Raspberry Pi."""
        return "Raspberry Pi" in self.model

    @property
    def is_root(self) -> bool:
        """True if this process may read every file."""
        return re.search(r"^Uid:\s+0\s", self.text("/proc/self/status"), re.MULTILINE) is not None

    def unit(self, name: str, *properties: str) -> dict[str, str]:
        """Return properties of a unit of systemd, or of systemd itself for ``""``; nothing where it does not answer."""
        words = ("systemctl", "show", *([name] if name else []), f"--property={','.join(properties)}")
        return dict(line.split("=", 1) for line in self.prints(*words).splitlines() if "=" in line)

    def is_active(self, unit: str) -> bool:
        """Check whether a unit of systemd is active."""
        return self.prints("systemctl", "is-active", unit) == "active"

    def _at(self, path: str) -> Path:
        return self.root / path.lstrip("/")


class Configured(Struct, frozen=True):
    """The facts that the checks ask of a configuration; without one it has no pins, no ports and no schedule.

    Attributes:
        why_none: Why a configuration that is there, or was named, cannot be used.
        pins: The GPIOs of its outputs and buttons.
        ports: The serial ports that its base names.
        is_scheduled: Whether any rule asks for the time of day.
        safe_lines: The lines of the list of safe outputs; none for simulated outputs.
        find_warnings: Returns what `check` finds, what this computer lacks first.
    """

    why_none: Diagnosis | None = None
    configuration: Configuration | None = None
    pins: frozenset[int] = frozenset()
    ports: tuple[str, ...] = ()
    is_scheduled: bool = False
    safe_lines: tuple[str, ...] = ()
    find_warnings: Callable[[], Sequence[Problem]] = tuple


# Of these, lgpio is looked for and not imported: it leaves a named pipe in the working directory.
IMPORT_S = 15.0
LIBRARIES = ("numpy", "cv2", "simplejpeg", "pydantic", "picamera2")
OPTIONAL = ("picamera2", "lgpio")

# Prints a line of JSON before each library and one after it; what crashes leaves out the latter.
PROBE = """
import importlib, importlib.util, json, sys
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

# What an extension says that was built for another major version of numpy.
_NUMPY_MIX = re.compile(
    r"dtype size changed|compiled (?:using|against) (?:NumPy|API)|_ARRAY_API|multiarray", re.IGNORECASE
)


def python_command() -> tuple[str, ...]:
    """Return the command that runs the Python of this environment, as the one that runs now was begun."""
    return (sys.executable, "-s") if sys.flags.no_user_site else (sys.executable,)


class Imports(Struct, frozen=True):
    """The output, line by line, of importing the libraries in another Python, and whether it ended in time."""

    lines: list[dict[str, Any]]
    is_late: bool = False

    def lacks(self, name: str) -> bool:
        """Check whether a library is not seen from this environment."""
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
    lines, found = imports.lines, [line for line in imports.lines if "name" in line]
    if not lines:
        yield unknown("Python could not be started anew, so the libraries were not tried")
        return
    troubles = [_broken(each, found) for each in found if each["error"]]
    if missing := [each["name"] for each in found if each["missing"] and each["name"] not in OPTIONAL]:
        troubles.append(wrong(f"{' and '.join(missing)} is not installed", _again("stadimeter")))
    if untried := lines[-1].get("trying"):
        how = "takes too long" if imports.is_late else "crashes Python"
        troubles.append(wrong(f"importing {untried} {how}", _again("stadimeter")))
    loaded = (each for each in found if each["name"] in LIBRARIES and not each["missing"])
    names = ", ".join(f"{each['name']} {each['version']}".strip() + _origin(each) for each in loaded)
    yield from troubles or [fine(f"Python {sys.version.split()[0]} in {sys.prefix}; {names} load together")]


def _origin(library: dict[str, Any]) -> str:
    return " (apt)" if "/dist-packages/" in library["file"] else ""


def _broken(library: dict[str, Any], found: list[dict[str, Any]]) -> Diagnosis:
    name, error = library["name"], " ".join(library["error"].split())[:160]
    if error == "too old":
        return wrong(*PICAMERA2_TOO_OLD.split("; "))
    if not _NUMPY_MIX.search(error):
        return wrong(f"{name} does not load: {error}", picamera2_remedy() if name == "picamera2" else _again(name))
    numpy = next((f"{each['version']}{_origin(each)}" for each in found if each["name"] == "numpy"), "")
    seen = f"{name} does not load beside numpy {numpy}: it was built for another numpy ({error})"
    is_of_apt = _origin(library) and not sys.prefix.startswith(PACKAGED)
    return wrong(seen, f"{shlex.quote(sys.executable)} -m pip install {NUMPY_1}" if is_of_apt else _again(name))


def _again(library: str) -> str:
    if sys.prefix.startswith(PACKAGED):
        return PACKAGE_AGAIN
    return f"{shlex.quote(sys.executable)} -m pip install --force-reinstall {library}"


def picamera2_remedy() -> str:
    """Return the remedy for a picamera2 that is missing or broken: what it needs is not on the package index."""
    return PICAMERA2 if sys.prefix.startswith(PACKAGED) else f"{PICAMERA2}, and {SEE_SYSTEM}"


# The subject of the examination -------------------------------------------------------------------------------------

# The configuration of the service, which is looked at if no other is named.
INSTALLED = "/etc/stadimeter/appliance.toml"

UNIT = "stadimeter.service"
SUDO = "call doctor with `sudo`"


@dataclass(frozen=True)
class Examined:
    """A computer and a configuration, which is read when it is first asked for.

    Attributes:
        path: The configuration; None for that of the service, if there is one.
    """

    computer: Computer
    path: Path | None = None

    @cached_property
    def imports(self) -> Imports:
        """The outcome of importing the libraries."""
        return import_libraries(self.computer)

    @cached_property
    def libraries(self) -> tuple[Diagnosis, ...]:
        """The findings on the libraries."""
        return tuple(libraries(self.imports))

    @property
    def is_of_service(self) -> bool:
        """True if the configuration is that of the service."""
        return self.path is None or self.path.resolve() == Path(INSTALLED)

    @cached_property
    def configured(self) -> Configured:
        """The configuration, or why it cannot be used."""
        path = self.path or self.computer.root / INSTALLED.lstrip("/")
        try:
            with suppress(IsADirectoryError):  # reading it says so
                path.open("rb").close()
        except PermissionError:
            return Configured(unknown(f"{path} is not yours to read", SUDO))
        except OSError:
            return Configured()
        if any(each.severity is DiagnosisSeverity.WRONG for each in self.libraries):
            return Configured(unknown(f"{path} was not read, since libraries do not load", "mend those first"))
        try:
            return _read_configured(path)
        except StadimeterError as error:
            return Configured(wrong(f"{path} cannot be used: {_first(error)}", f"`stadimeter check {path}` shows all"))


def _first(error: StadimeterError) -> str:
    """Return the first of several errors in one line, and how many more there are."""
    lines = [str(each) for each in error.problems] if isinstance(error, ConfigError) else [str(error)]
    more = f", and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"{' '.join(lines[0].split())}{more}"


def _read_configured(path: Path) -> Configured:
    """Read a configuration; raises `StadimeterError` if it cannot be used. Loads numpy, pydantic and the drivers."""
    from stadimeter.app.feasibility import feasibility_warnings  # noqa: PLC0415
    from stadimeter.app.service import safe_lines  # noqa: PLC0415
    from stadimeter.app.this_computer import warnings_here  # noqa: PLC0415
    from stadimeter.config.loader import load_configuration  # noqa: PLC0415
    from stadimeter.config.plugins import marked_options  # noqa: PLC0415
    from stadimeter.config.units import PortMark  # noqa: PLC0415
    from stadimeter.workbench.wiring import find_outputs, parts_of  # noqa: PLC0415

    found = load_configuration(path)
    ports = marked_options(found.base.options, PortMark) if found.base is not None else ()
    return Configured(
        configuration=found,
        pins=frozenset(output.gpio for output in find_outputs(parts_of(found))),
        ports=tuple(str(port) for _key, port in ports if str(port).startswith("/")),
        is_scheduled=found.plan.needs_wall_time,
        safe_lines=tuple(line for each in found.driven if not each.is_simulated for line in safe_lines(each)),
        find_warnings=lambda: (*warnings_here(found), *found.warnings, *feasibility_warnings(found)),
    )
