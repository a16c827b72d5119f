"""The checks of a computer: the board, its devices, the configuration, its broker and the service.

Files are read below a root and commands are run through a function, so that tests put captured texts in their place.
Whether the libraries that read pictures load together is tried in another Python, which may crash or hang.

Sources: Raspberry Pi's documentation ("Raspberry Pi OS": ``vcgencmd``; "Configuration": ``config.txt``, UARTs; "Camera
software"; "Conditional filters"), the firmware's overlays/README, linux/gpio.h, the kernel's drivers ``unicam`` and
``rp1-cfe`` of its two camera ports, systemctl(1), systemd.service(5), systemd-system.conf(5) and proc(5).
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from stadimeter.app.clock import is_synchronised
from stadimeter.app.live.health import FAILED_UPGRADE, throttling
from stadimeter.app.places import SERVICE_STATE, STATE_ENDING, state_file
from stadimeter.config import extras
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.messaging.protocol import ReachesItsPeer

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


# All is well; something may become a problem; it is wrong; it cannot be found out here.
fine = partial(Diagnosis, DiagnosisSeverity.FINE)
warning = partial(Diagnosis, DiagnosisSeverity.WARNING)
wrong = partial(Diagnosis, DiagnosisSeverity.WRONG)
unknown = partial(Diagnosis, DiagnosisSeverity.UNKNOWN)

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


# ``GPIO_V2_GET_LINEINFO_IOCTL`` of linux/gpio.h, and ``gpio_v2_line_info``: name, what holds the line, number, count of
# attributes, flags (the first: it is held), attributes and reserved.
GET_LINE = 0xC100B405
LINE = struct.Struct("=32s32sIIQ176x")


def find_holder(chip: Path, gpio: int, ioctl: Callable[[int, int, bytes], bytes] = fcntl.ioctl) -> str:
    """Return which program or driver holds a pin, as the kernel names it; empty if none does. Raises `OSError`."""
    with chip.open("rb") as file:
        answer = ioctl(file.fileno(), GET_LINE, LINE.pack(b"", b"", gpio, 0, 0))
    _name, holder, _gpio, _count, flags = LINE.unpack(answer)
    return _text(holder.rstrip(b"\0")) or "a driver of the kernel" if flags & 1 else ""


class Computer(Struct, frozen=True, kw_only=True):
    """Access to everything that the checks may ask.

    Attributes:
        root: Where ``/proc``, ``/sys``, ``/etc`` and ``/boot`` are found.
        run: Runs a command within a time limit in seconds; None where it is not installed.
        is_clock_right: Whether the clock is synchronised.
        free_bytes: The free space of the file system that a path is on; raises `OSError`.
        find_holder: What holds a pin of a chip; see `find_holder`.
    """

    root: Path = Path("/")
    run: Callable[[Sequence[str], float], CommandResult | None] = run_command
    is_clock_right: Callable[[], bool] = is_synchronised
    free_bytes: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free
    find_holder: Callable[[Path, int], str] = find_holder

    def has(self, path: str) -> bool:
        """Check whether there is such a file or folder."""
        return os.path.lexists(self.at(path))

    def text(self, path: str) -> str:
        """Return the text of a file without spaces around it; ``""`` where it cannot be read."""
        try:
            return self.at(path).read_text("utf-8", "replace").strip("\0 \n")
        except OSError:
            return ""

    def paths(self, pattern: str) -> list[str]:
        """List the paths that fit a pattern such as ``/dev/gpiochip*``, sorted."""
        return sorted(f"/{found.relative_to(self.root)}" for found in self.root.glob(pattern.lstrip("/")))

    def at(self, path: str) -> Path:
        """Return where a path is found."""
        return self.root / path.lstrip("/")

    def node(self, path: str) -> str:
        """Return the name of the device that a path such as ``/dev/serial0`` leads to."""
        return self.at(path).resolve().name

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


class Configured(Struct, frozen=True):
    """The facts that the checks ask of a configuration; without one it has no pins, no ports and no schedule.

    Attributes:
        why_none: Why a configuration that is there, or was named, cannot be used.
        pins: Its outputs and buttons by their GPIOs.
        ports: The serial ports that its base names.
        is_scheduled: Whether any rule asks for the time of day.
        safe_lines: The lines of the list of safe outputs; none for simulated outputs.
        find_warnings: Returns what `check` finds, what this computer lacks first.
    """

    why_none: Diagnosis | None = None
    configuration: Configuration | None = None
    pins: Mapping[int, str] = {}
    ports: tuple[str, ...] = ()
    is_scheduled: bool = False
    safe_lines: tuple[str, ...] = ()
    find_warnings: Callable[[], Sequence[Problem]] = tuple


# Of these, lgpio is looked for and not imported: it leaves a named pipe in the working directory.
IMPORT_S = 15.0
LIBRARIES = ("numpy", "cv2", "simplejpeg", "pydantic", "picamera2")
OPTIONAL = ("picamera2", "lgpio")

# The packages on the package index that are not named as what they bring.
DISTRIBUTIONS = {"cv2": "opencv-python-headless"}

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
        troubles.append(wrong(f"{' and '.join(missing)} is not installed", _again(*missing)))
    if untried := lines[-1].get("trying"):
        how = "takes too long" if imports.is_late else "crashes Python"
        troubles.append(wrong(f"importing {untried} {how}", _again(untried)))
    loaded = (each for each in found if each["name"] in LIBRARIES and not each["missing"])
    names = ", ".join(f"{each['name']} {each['version']}".strip() + _origin(each) for each in loaded)
    yield from troubles or [fine(f"Python {sys.version.split()[0]} in {sys.prefix}; {names} load together")]


def _origin(library: dict[str, Any]) -> str:
    return " (apt)" if "/dist-packages/" in library["file"] else ""


def _broken(library: dict[str, Any], found: list[dict[str, Any]]) -> Diagnosis:
    name, error = library["name"], " ".join(library["error"].split())[:160]
    if error == "too old":
        return wrong(*extras.PICAMERA2_TOO_OLD.split("; "))
    if not _NUMPY_MIX.search(error):
        return wrong(f"{name} does not load: {error}", _again(name))
    numpy = next((f"{each['version']}{_origin(each)}" for each in found if each["name"] == "numpy"), "")
    seen = f"{name} does not load beside numpy {numpy}: it was built for another numpy ({error})"
    if sys.prefix.startswith(extras.PACKAGED):
        return wrong(seen, extras.PACKAGE_AGAIN)
    older = f"{shlex.quote(sys.executable)} -m pip install {extras.NUMPY_1}"
    return wrong(seen, older if _origin(library) else _again(name))


def _again(*libraries: str) -> str:
    if "picamera2" in libraries:  # what it needs is not on the package index
        return f"`{extras.of_system('python3-picamera2')}`"
    if sys.prefix.startswith(extras.PACKAGED):
        return extras.PACKAGE_AGAIN
    names = " ".join(DISTRIBUTIONS.get(each, each) for each in libraries)
    return f"{shlex.quote(sys.executable)} -m pip install --force-reinstall {names}"


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

    @property
    def state(self) -> Path:
        """The folder of what runs keep."""
        file = None if self.path is None or self.is_of_service else state_file(self.path)
        return file.parent if file is not None else self.computer.at(str(SERVICE_STATE))

    @cached_property
    def configured(self) -> Configured:
        """The configuration, or why it cannot be used."""
        path = self.path or self.computer.at(INSTALLED)
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
        pins={output.gpio: output.name for output in find_outputs(parts_of(found))},
        ports=tuple(str(port) for _key, port in ports if str(port).startswith("/")),
        is_scheduled=found.plan.needs_wall_time,
        safe_lines=tuple(line for each in found.driven if not each.is_simulated for line in safe_lines(each)),
        find_warnings=lambda: (*warnings_here(found), *found.warnings, *feasibility_warnings(found)),
    )


# The board: its supply, clock and disk -----------------------------------------------------------------------------

SUPPLY = (
    "use the supply for the board (5 V and 3 A; 5 A for a Pi 5) and a short, thick cable, and another one for motors"
)
COOL = "a heat sink or a fan, and air around the board"
# To load the libraries takes a Zero 2 W some seconds.
SPEED_S = 30.0
LOW_BYTES, FULL_BYTES = 500e6, 1e6
REMOUNT = "`sudo mount -o remount,rw {}`; if that does not last, another memory card"


def system(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which board and system this is."""
    computer = examined.computer
    release = re.search(r'^PRETTY_NAME="?([^"\n]*)', computer.text("/etc/os-release"), re.MULTILINE)
    name = release[1] if release else "an unknown system"
    left_out = "" if computer.is_pi else "; pins, supply and ribbon cameras are left out"
    yield fine(f"{computer.model or 'no Raspberry Pi'}, {name}{left_out}")


def supply(examined: Examined) -> Iterator[Diagnosis]:
    """Tell of too low a voltage and of a processor that is slowed, at this moment or since the start."""
    computer = examined.computer
    if not computer.is_pi:
        return
    found = re.search(r"throttled=0x([0-9a-fA-F]+)", computer.prints("vcgencmd", "get_throttled"))
    if found is None:
        yield unknown("whether the supply suffices: vcgencmd does not say")
        return
    state = throttling(int(found[1], 16))
    words = f"vcgencmd get_throttled: 0x{found[1]}"
    remedy = SUPPLY if "under-voltage" in (*state.now, *state.before) else COOL
    if state.now:
        yield wrong(f"{' and '.join(state.now)} now ({words})", remedy)
    elif state.before:
        yield warning(f"{' and '.join(state.before)} since the start, not now ({words})", remedy)
    else:
        yield fine(f"no under-voltage and no throttling since the start ({words})")


def speed(examined: Examined) -> Iterator[Diagnosis]:
    """Tell how many pictures a second it can look through for a ball."""
    answer = examined.computer.run((*python_command(), "-m", "stadimeter.workbench.doctor.speed"), SPEED_S)
    if answer is not None:
        seen = f"it looks through {answer.output.strip()} pictures of 640x480 a second for a ball of one colour"
        broken = "how fast it is: the libraries do not work together"
        yield fine(seen) if answer.code == 0 else unknown(broken)


def clock(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the clock is synchronised: schedules wait for that, and times in logs are wrong without it."""
    remedy = "`sudo timedatectl set-ntp true`, and a network; a Pi 5 keeps time with a battery on its clock"
    seen = "the clock is not synchronised"
    if examined.computer.is_clock_right():
        yield fine("the clock is synchronised")
    elif examined.configured.is_scheduled:
        yield wrong(f"{seen}, and rules with a schedule wait for it", remedy)
    else:
        yield warning(f"{seen}: times in logs and messages may be wrong", remedy)


def disk(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the folder of the state can be written, and how much is free there."""
    computer, folder = examined.computer, examined.state
    there = next(each for each in (folder, *folder.parents) if os.path.lexists(each))
    try:
        free, is_read_only = computer.free_bytes(there), os.statvfs(there).f_flag & os.ST_RDONLY
        others = [
            each for each in sorted(folder.glob(f"*{STATE_ENDING}*")) if each.stat().st_uid != there.stat().st_uid
        ]
    except OSError as error:
        yield unknown(f"the free space of {folder}: {error.strerror}")
        return
    owner, mounted = f"--reference={folder}", f'"$(findmnt -no TARGET -T {there})"'
    is_ours = examined.configured.configuration is not None and (computer.is_root or not examined.is_of_service)
    if is_ours and not os.access(there, os.W_OK):
        others, owner = [there], "$USER"
    if is_read_only:
        yield wrong(f"{folder} is on a read-only disk: nothing that alarms remember is kept", REMOUNT.format(mounted))
    elif others:
        seen = f"{others[0]} belongs to another user: nothing that alarms remember is kept"
        yield wrong(seen, f"`sudo mkdir -p {folder} && sudo chown -R {owner} {folder}`")
    remedy = f"delete old journals and recordings (`sudo du -axh {mounted} | sort -h | tail` finds what is large)"
    judged = wrong if free < FULL_BYTES else warning
    seen = f"{free / 1e9:.1f} GB are free for {folder}"
    yield fine(seen) if free >= LOW_BYTES else judged(seen, remedy)


# Groups, cameras, pins and serial ports ----------------------------------------------------------------------------

GROUPS = {"video": "cameras", "dialout": "serial ports", "gpio": "pins"}
LIST_S = 20.0
IN_USE = "another program is using it"

# The serial ports of GPIO 14 and 15. The console of a Pi 5 is on a connector of its own, as ttyAMA10.
CONFIG_TXT = "/boot/firmware/config.txt"
ON_HEADER = ("ttyAMA0", "ttyS0")

# What takes pins when config.txt names it: for each the parameter that chooses it, with its default.
TAKES_PINS: dict[str, dict[str, int]] = tomllib.loads(Path(__file__).with_name("pins_taken.toml").read_text("utf-8"))
_SOUND = re.compile(r"(hifiberry|iqaudio|justboom|allo-|audioinjector|rpi-\w*dac|i2s-dac)[\w-]*")
_SETTING = re.compile(r"([\w-]+)(?:=(\w+))?")

ATTACH = "plug one in, or try another socket and cable; `ls /dev/video*` lists those that the kernel knows"
ATTACH_TO_PI = (
    "another socket for a webcam. A ribbon camera: switch off, plug the cable in anew (a Pi 5 and a Zero need the"
    f" narrow one), `rpicam-hello --list-cameras`; `camera_auto_detect=1` in {CONFIG_TXT}, and the `dtoverlay` of a"
    " module that is not Raspberry Pi's own"
)


def groups(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether this process may use cameras, serial ports and pins."""
    computer = examined.computer
    if computer.is_root:
        yield fine("root may use every device; other users need the groups video, dialout and gpio")
        return
    status = re.search(r"^Groups:(.*)", computer.text("/proc/self/status"), re.MULTILINE)
    ours = status[1].split() if status else ()
    entries = [line.split(":") for line in computer.text("/etc/group").splitlines() if line.count(":") == 3]
    lacking = [group for group, _password, number, _members in entries if group in GROUPS and number not in ours]
    for group in lacking:
        remedy = f"`sudo usermod -aG {group} $USER`, then log out and in again, or restart"
        yield warning(f"this user is not in the group {group}, which may use {GROUPS[group]}", remedy)
    if not lacking:
        yield fine("this user may use cameras, serial ports and pins")


def cameras(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which cameras are there, by which stack, and what keeps one from being used."""
    computer = examined.computer
    answer = computer.run((*python_command(), "-m", "stadimeter", "cameras", "--no-try", "--json"), LIST_S)
    try:
        found: list[dict[str, Any]] = json.loads(answer.output if answer is not None else "")
    except ValueError:
        yield unknown("the cameras could not be listed", "`stadimeter cameras` says why")
        return
    for camera in found:
        stack = "libcamera" if camera["driver"] == "picamera2" else "V4L2"
        seen = f"{camera['name']}, by {stack}: {camera['device']}"
        if camera["trouble"].startswith(IN_USE) and computer.is_active(UNIT):
            yield fine(f"{seen}; it is in use, and the service runs")
        elif camera["trouble"]:
            yield wrong(f"{seen}; it cannot be used", camera["trouble"])
        else:
            yield fine(seen)
    if not any(each["driver"] == "picamera2" for each in found):
        yield from _absent(examined, has_any=bool(found))


def _absent(examined: Examined, *, has_any: bool) -> Iterator[Diagnosis]:
    """Tell why there is no camera on a ribbon cable, or none at all."""
    computer, configured = examined.computer, examined.configured.configuration
    driver = configured.camera.driver if configured is not None else ""
    is_stream = configured is not None and getattr(configured.camera.options, "is_stream", False)
    # The kernel makes these nodes when it has found a sensor on a ribbon cable.
    nodes = [computer.text(path) for path in computer.paths("/sys/class/video4linux/video*/name")]
    if any(name.startswith(("unicam", "rp1-cfe")) for name in nodes):
        if examined.imports.lacks("picamera2"):
            seen = "a ribbon camera is there, and this Python does not see the library picamera2"
            yield wrong(seen, _again("picamera2"))
        else:
            remedy = "`rpicam-hello --list-cameras`; mend the libraries first, if one does not load"
            yield unknown("the kernel knows a ribbon camera, and libcamera does not list it", remedy)
    elif driver == "picamera2" or (not has_any and driver in {"", "opencv"} and not is_stream):
        seen = "no ribbon camera is found" if has_any else "no camera is found"
        yield wrong(seen, ATTACH_TO_PI if computer.is_pi else ATTACH)
    elif not has_any:
        yield fine("no camera is found, and the configuration needs none")


def pins(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether a Pi's pins can be driven, and those of the configuration; without a Pi, `check` says it."""
    computer = examined.computer
    if not computer.is_pi:
        return
    if examined.imports.lacks(extras.LIBRARIES["pi"]):
        yield warning("the library lgpio, which drives pins, is not installed", f"`{extras.install_line('pi')}`")
    elif not computer.has("/dev/gpiochip0"):
        yield wrong("there is no /dev/gpiochip0", "`sudo apt full-upgrade`, and restart: the kernel has no driver")
    else:
        yield fine("pins are driven through lgpio")
        yield from _taken_pins(examined)


def _taken_pins(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which pins of the configuration the system takes at its start, or a driver or program holds now."""
    computer, lines = examined.computer, {gpio: line for line, gpio in _pins_of_lines(examined.computer)}
    # As gpiozero chooses it.
    number = 4 if "Pi 5 " in computer.model and computer.has("/dev/gpiochip4") else 0
    for gpio, name in examined.configured.pins.items():
        holder, seen = "", f"GPIO {gpio} of '{name}'"
        with suppress(OSError):  # not this user's to ask, which the groups say
            holder = computer.find_holder(computer.at(f"/dev/gpiochip{number}"), gpio)
        if gpio in lines:
            remedy = f"another pin for '{name}'; or put # before that line, and restart"
            yield wrong(f"{seen} is taken by the line {lines[gpio]}", remedy)
        elif holder and not (holder == "lg" and computer.is_active(UNIT)):
            seen = f"{seen} is held by '{holder}', as the kernel calls it"
            close = f"close that program (`sudo fuser -v /dev/gpiochip{number}` names it), or switch off that driver"
            yield wrong(seen, f"{close}; or another pin for '{name}'")


def filters_of(model: str) -> set[str]:
    """Return the filters of config.txt below which lines are for a board."""
    board = re.search(r"Pi (?:Compute Module )?(\d|Zero)(00)?", model)
    number = board[1].replace("Zero", "0") if board else "1"
    return {
        "[all]", f"[pi{number}]", f"[cm{number}]" * ("Compute" in model), f"[pi{number}00]" * bool(board and board[2]),
        "[pi3+]" * ("Pi 3" in model and "Plus" in model), "[pi0w]" * (" W" in model), "[pi02]" * ("Zero 2" in model),
    }  # fmt: skip


def _our_lines(computer: Computer) -> Iterator[tuple[str, str]]:
    """Yield each line of config.txt that is for this board, or of a file that it includes, and that file."""
    main, is_ours = CONFIG_TXT if computer.has(CONFIG_TXT) else "/boot/config.txt", True
    for line in map(str.strip, computer.text(main).splitlines()):
        is_ours = line.lower() in filters_of(computer.model) if line.startswith("[") else is_ours
        file = f"{Path(main).parent}/{line[8:].strip()}" if line.startswith("include ") else ""
        lines = [(each.strip(), file) for each in computer.text(file).splitlines()] if file else [(line, main)]
        yield from lines if is_ours else ()


def _pins_of_lines(computer: Computer) -> Iterator[tuple[str, int]]:
    """Yield each line of config.txt that takes pins, with each of them, save what stands below a filter for others."""
    last: tuple[str, str, dict[str, str]] = ("", "", {})
    found: dict[str, tuple[str, str, dict[str, str]]] = {}
    for line, file in _our_lines(computer):
        kind, _, rest = line.partition("=")
        settings = (line if kind == "enable_uart" else rest).partition(" #")[0]
        where, values = f"`{line}` of {file}", dict(_SETTING.findall(settings))
        if kind == "dtoverlay":
            name = _SOUND.sub("sound", next(iter(values), "").removeprefix("pi3-"))
            last = found[where] = ("" if "Pi 5" in computer.model and name.endswith("-bt") else name, where, values)
        for name, value in values.items() if kind in {"dtparam", "enable_uart"} else ():
            if name in TAKES_PINS.get(last[0], ()):  # it is of the overlay above
                last[2][name] = value
            elif name in TAKES_PINS:
                found[str(TAKES_PINS[name])] = ("" if value in {"off", "0", "no", "false"} else name, where, {})
    for name, where, values in found.values():
        for choice, gpio in TAKES_PINS.get(name, {}).items():
            yield where, int(values[choice]) if values.get(choice, "").isdecimal() else gpio


def serial(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the system's console, or a program that searches for modems, takes a serial port."""
    computer, configured = examined.computer, examined.configured
    console = re.search(r"console=(ttyAMA\d+|ttyS\d+)", computer.text("/proc/cmdline"))
    if computer.is_pi and console:
        is_on_header = console[1] in ON_HEADER
        where = f"{console[1]} (GPIO 14 and 15)" if is_on_header else console[1]
        if console[1] in map(computer.node, configured.ports) or (is_on_header and {14, 15} & configured.pins.keys()):
            yield wrong(
                f"the system's console is on {where}, which the configuration uses",
                "`sudo raspi-config nonint do_serial_cons 1`, and restart",
            )
        else:
            yield fine(f"the system's console is on {where}; leave that free")
    if configured.ports or computer.paths("/dev/tty[UA][SC][BM]*"):
        if computer.is_active("ModemManager.service"):
            seen = "ModemManager runs, and writes to serial ports that it does not know"
            yield warning(seen, "`sudo systemctl disable --now ModemManager`")
        if computer.paths("/usr/lib/udev/rules.d/*brltty*"):
            seen = "brltty is installed, and takes CH340 adapters for Braille displays"
            yield warning(seen, "`sudo apt remove brltty`")
    if found := computer.paths("/dev/serial/by-id/*"):
        yield fine(f"serial ports, by the names that stay right: {', '.join(found)}")


# The configuration, its broker and the service ---------------------------------------------------------------------

# The findings of ``check`` that keep a configuration from running on this computer.
ELSEWHERE = frozenset({"driver-lacks", "will-not-run"})


def configuration(examined: Examined) -> Iterator[Diagnosis]:
    """Tell in a line what ``check`` finds."""
    found = examined.configured
    if found.why_none is not None:
        yield found.why_none
        return
    if found.configuration is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    path, problems = found.configuration.path, found.find_warnings()
    if not problems:
        yield fine(f"{path} can be used, and `check` finds nothing")
        return
    more = f"; and {len(problems) - 1} more" if len(problems) > 1 else ""
    judged = wrong if any(each.code in ELSEWHERE for each in problems) else warning
    yield judged(f"{path}: {problems[0].message}{more}", f"`stadimeter check {path}` shows all")


def broker(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the broker that the configuration names takes its login."""
    found = examined.configured.configuration
    messenger = found.messenger if found else None
    if messenger is None or not isinstance(messenger.options, ReachesItsPeer):
        return
    if trouble := messenger.options.reach():
        seen, _, remedy = trouble.partition("; ")
        yield wrong(seen, remedy or f"{extras.guide('troubleshooting.md')} says what to do")
    else:
        yield fine("the broker takes the connection with the configuration's login")


STATE = (
    "LoadState", "ActiveState", "SubState", "Result", "NRestarts", "UnitFileState", "StatusText", "FragmentPath",
    "DropInPaths", "NeedDaemonReload",
)  # fmt: skip
RESTARTS_MANY = 3
PAGE = "stadimeter-web.service"
ANOTHER = "when that is mended, or with another one: `sudo apt install --reinstall --allow-downgrades ./FILE.deb`"


def service(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the service is installed, enabled and running, and the page's if it is used."""
    if failed_upgrade := examined.computer.text(FAILED_UPGRADE):
        yield wrong(failed_upgrade, ANOTHER)
    state, page = (examined.computer.unit(unit, *STATE) for unit in (UNIT, PAGE))
    if not state:
        yield unknown("the service: systemctl does not answer")
    elif state.get("LoadState") == "not-found":
        yield fine("stadimeter is not installed as a service on this computer")
    else:
        yield _judge_unit("the service", UNIT, state)
    if page.get("UnitFileState") == "enabled" or page.get("ActiveState", "inactive") != "inactive":
        yield _judge_unit("the page's service", PAGE, page)


def _judge_unit(what: str, unit: str, state: dict[str, str]) -> Diagnosis:
    active, load, result = (state.get(name, f"no {name}") for name in ("ActiveState", "LoadState", "Result"))
    order = f"`sudo systemctl {{}} {unit}`".format
    paths = f"{state.get('FragmentPath')} {state.get('DropInPaths')}".split()
    ours = " and ".join(each for each in paths if each.startswith(("/etc", "/run")) and unit in each)
    changed, revert = (f", changed by {ours}", f"; {order('revert')} undoes that") if ours else ("", "")
    restarts = int(state.get("NRestarts") or 0)
    more = f"{restarts} restarts{changed}" + (f", and says: {state['StatusText']}" if state.get("StatusText") else "")
    log, verify = f"`sudo journalctl -eu {unit}`{revert}", f"`systemd-analyze verify {unit}`{revert}"
    again = f"; then {order('reset-failed')}" if result == "start-limit-hit" else ""
    has_failed = active == "failed" or state.get("SubState") == "auto-restart"
    masked = f"{what} is masked" + (f" and has failed ({result})" if active == "failed" else "")
    ended = ", and one that runs is ended as if it hung, and may leave outputs on" if unit == UNIT else ""
    unmask = f"{order('unmask')}, and then {order('start')}"
    anew = f"`sudo systemctl daemon-reload` and {order('restart')}"
    is_enabled = state.get("UnitFileState") == "enabled"
    judged = (
        # systemd knows none of its settings then, and refuses what it reports
        (load == "masked", wrong(f"{masked}: nothing starts it{ended}", unmask)),
        # such as an ExecStart of `systemctl edit` without an empty one before it
        (load != "loaded", wrong(f"{what} cannot be started ({load}){changed}", verify)),
        (has_failed, wrong(f"{what} has failed ({result}), {more}", f"{log}{again}")),
        (active in {"activating", "deactivating"}, warning(f"{what} is {active}, {more}", log)),
        (active not in {"active", "reloading"}, warning(f"{what} is {active}", order("enable --now"))),
        (state.get("NeedDaemonReload") == "yes", warning(f"{what} runs, and its unit was changed since", anew)),
        (restarts > RESTARTS_MANY, warning(f"{what} runs, after {more}", log)),
        (not is_enabled, warning(f"{what} runs, and is not started at boot", order("enable"))),
        (True, fine(f"{what} runs, {more}")),
    )
    return next(diagnosis for applies, diagnosis in judged if applies)


SAFE_OUTPUTS = "/run/stadimeter/safe-outputs.conf"
SWITCHES_OFF = "/usr/lib/stadimeter/safe-outputs"


def safe_outputs(examined: Examined) -> Iterator[Diagnosis]:
    """Compare the outputs that are switched off after the service with those of the configuration, and try the way."""
    computer, wanted = examined.computer, examined.configured.safe_lines
    if not wanted or not examined.is_of_service or not computer.has(SWITCHES_OFF):
        return
    if not computer.is_root:
        yield unknown("whether all outputs can be switched off after the service", SUDO)
        return
    if not computer.has(SAFE_OUTPUTS):
        yield unknown("which outputs are switched off after the service: it lists them when it starts")
        return
    if lacking := set(wanted) - set(computer.text(SAFE_OUTPUTS).splitlines()):
        seen = f"after the service has ended, these are not switched off: {', '.join(sorted(lacking))}"
        yield wrong(seen, f"`sudo systemctl restart stadimeter`, which lists the outputs of {INSTALLED}")
    answer = computer.run((SWITCHES_OFF, "--check"), COMMAND_S)
    way = answer.output.strip() if answer is not None else ""
    if answer is not None and answer.error.strip():
        seen = f"of what is switched off after the service: {answer.error.splitlines()[0]}"
        yield wrong(seen, f"`sudo {SWITCHES_OFF} --check` shows all; mend its file")
    if way in {"", "nothing"}:
        seen = "the pins cannot be switched off after the service, so a killed service leaves them as they are"
        yield wrong(seen, "`sudo apt install raspi-utils`, which brings pinctrl" if way else extras.PACKAGE_AGAIN)
    elif not lacking:
        yield fine(f"outputs are switched off after the service{'' if way == 'no pins' else f', pins by {way}'}")


def watchdogs(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether a hung program, and a hung system, are restarted."""
    computer = examined.computer
    unit = computer.unit(UNIT, "LoadState", "WatchdogUSec")
    if unit.get("LoadState") == "loaded":
        limit = unit.get("WatchdogUSec")
        lacking = warning("the service has no watchdog", "`WatchdogSec=` is missing: install the package anew")
        yield fine(f"the service is restarted when it hangs for {limit}") if _is_set(limit) else lacking
    if computer.is_pi:
        limit = computer.unit("", "RuntimeWatchdogUSec").get("RuntimeWatchdogUSec")
        remedy = "`RuntimeWatchdogSec=15` below `[Manager]` in /etc/systemd/system.conf.d/watchdog.conf, and restart"
        lacking = warning("the board does not restart when the system hangs", remedy)
        yield fine(f"the board restarts when the system hangs for {limit}") if _is_set(limit) else lacking


def _is_set(duration: str | None) -> bool:
    return duration not in {None, "", "0", "infinity"}


class Check(Struct, frozen=True):
    """A check.

    Attributes:
        group: The heading that its lines stand under, which `doctor computer --help` explains.
        name: Its name for programs.
        doing: What it does, for people who wait for it.
        find: Yields what it finds; nothing where it does not apply.
    """

    group: str
    name: str
    doing: str
    find: Callable[[Examined], Iterable[Diagnosis]]


CHECKS = (
    Check("This computer", "system", "reading which system this is", system),
    Check("This computer", "supply", "asking for the supply", supply),
    Check("This computer", "speed", "measuring how fast it is", speed),
    Check("This computer", "clock", "asking for the clock", clock),
    Check("This computer", "disk", "reading the free space", disk),
    Check("Python and libraries", "libraries", "loading the libraries", lambda examined: examined.libraries),
    Check("Cameras, pins and ports", "groups", "reading the groups", groups),
    Check("Cameras, pins and ports", "cameras", "listing the cameras", cameras),
    Check("Cameras, pins and ports", "pins", "looking for pins", pins),
    Check("Cameras, pins and ports", "serial", "looking for serial ports", serial),
    Check("Configuration", "configuration", "checking the configuration", configuration),
    Check("Configuration", "broker", "connecting to the broker", broker),
    Check("Service", "service", "asking for the service", service),
    Check("Service", "safe-outputs", "comparing the safe outputs", safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", watchdogs),
)
