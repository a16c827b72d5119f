"""The run as a service of systemd: tells it how things are, feeds its watchdog, and restarts when the camera is gone.

systemd takes datagrams, as ``sd_notify(3)`` describes them. A run is a service if systemd has set
``NOTIFY_SOCKET``; else none of this is loaded.

The watchdog is fed by the loop at the end of a cycle and by nothing else: a loop that hangs, for whatever reason, is
killed within ``WatchdogSec``. A camera without pictures is no such hang. The cycles go on, the outputs are at their
safe values, and `app.capture` opens the camera again and again. Only when that has not helped for long does the process
end itself, in order, for systemd to start it anew: what hangs may be a library in it. So that this is no loop of
restarts, each process in a row that gets no pictures is more patient than the one before, and one that fails early
waits first.

A killed program leaves its pins as they were. So each run writes, before it opens an output, which pins and which ports
its configuration has, so there is no second list. The file is in the runtime folder, which is in memory.
``safe-outputs`` runs as root, and this file is ours: it takes nothing from it but the lines below, checked again.

    pin NUMBER low|high          the GPIO's level at which what hangs on it is off
    serial PORT BAUD HEX         the bytes that stop what listens there
"""

from __future__ import annotations

import faulthandler
import math
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.places import runtime_directory
from stadimeter.config.files import holds, write_atomically
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, StopsByBytes, StopsByI2c, marked_options
from stadimeter.config.units import PinMark, PortMark
from stadimeter.core.decision import Decision, SafetyMode
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError

# Without a new frame for this long, the process restarts: after the first of these, or the second if nothing but
# another process can use the camera; doubled with each start in a row, up to the longest.
PATIENCE_S = 300.0
PATIENCE_IF_HUNG_S = 30.0
MAX_PATIENCE_S = 3600.0

# From the third start in a row on, a process waits before it opens anything: 1 s, doubled each time, up to this.
MAX_PAUSE_S = 30.0

# After this long with pictures, the next restart is the first in a row again.
PROVEN_S = 300.0

# A longer time without a new frame interrupts `PROVEN_S`.
GAP_S = 2.0

STATUS_EVERY_S = 1.0

# The watchdog waits this long for a program that begins anew: it loads its libraries, and opens its devices.
RESTART_WITHIN_S = 30.0

# The watchdog is fed this many times within its period.
FEEDS = 4


class NotifySocket:
    """Sends datagrams to systemd. Never waits and never fails: a run does not depend on who watches it.

    Args:
        address: That of ``NOTIFY_SOCKET``: a path, or ``@`` and the name of an abstract socket.
    """

    def __init__(self, address: str) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address

    def send(self, *lines: str) -> bool:
        """Send assignments such as ``READY=1``; return whether they arrived. Line breaks in values become spaces."""
        data = "\n".join(" ".join(line.split()) for line in lines).encode()
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            sender.sendto(data, self._address)
            return True
        return False


def pause_s(failed: int) -> float:
    """Return the time to wait before devices are opened, after this many starts in a row without lasting pictures."""
    return min(2.0 ** (failed - 2), MAX_PAUSE_S) if failed > 1 else 0.0


def patience_s(failed: int, *, is_hung: bool) -> float:
    """Return the time a process may go without a new frame, after this many starts in a row like it."""
    first_s = PATIENCE_IF_HUNG_S if is_hung else PATIENCE_S
    return min(first_s * 2.0 ** min(failed, 30), MAX_PATIENCE_S)


class FailedStarts:
    """Counts the starts in a row that did not bring lasting pictures, in a file that outlives the process.

    The file is in the runtime folder, which is in memory: no disk is written, and a reboot begins anew. So does a
    configuration that was edited: a repair takes effect without a wait.
    """

    def __init__(self, folder: Path, configuration: Path) -> None:
        self._path = folder / "failed-starts"
        self._version = 0
        with suppress(OSError):
            self._version = configuration.stat().st_mtime_ns

    def begin(self) -> int:
        """Return the number of failed starts before this one, and count this one until `forget` is called."""
        try:
            count, version = map(int, self._path.read_text().split())
        except (OSError, ValueError):
            count, version = 0, 0
        failed = count if version == self._version else 0
        with suppress(OSError):
            self._path.write_text(f"{failed + 1} {self._version}")
        return failed

    def forget(self) -> None:
        """Begin anew: this start was a good one, or its end was asked for."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)


class CameraWait(Struct):
    """Decides from cycle to cycle whether waiting for the camera still makes sense.

    ===================================  ================================================================
    for this long                        what follows
    ===================================  ================================================================
    no new frame for `patience_s`        the process ends, to be started anew
    new frames for `PROVEN_S`            this start was a good one: `failed` is 0 again
    ===================================  ================================================================

    Attributes:
        failed: How many starts in a row, before this one, brought no lasting pictures.
    """

    failed: int
    _newest_s: float | None = None
    _good_since_s: float = math.inf

    def is_over(self, now_s: float, *, has_frame: bool, is_hung: bool = False) -> bool:
        """Take in a cycle, and return whether the process should end."""
        if self._newest_s is None:
            self._newest_s = now_s
        if has_frame:
            if now_s - self._newest_s > GAP_S or self._good_since_s == math.inf:
                self._good_since_s = now_s
            self._newest_s = now_s
            if self.is_proven(now_s):
                self.failed = 0
        return now_s - self._newest_s > patience_s(self.failed, is_hung=is_hung)

    def is_proven(self, now_s: float) -> bool:
        """Check whether there have been pictures for so long that this start was a good one."""
        return now_s - self._good_since_s >= PROVEN_S


class Service:
    """The run as systemd sees it. Called after each cycle, as a listener of the loop.

    Args:
        watchdog_s: The period of the watchdog; None for none.
        starts: What is known of earlier starts; None without a runtime folder.
        trouble: Says what is wrong outside the loop.
        hung: Says why nothing but another process can use the camera; empty if that is not so.
        clock: Real time in seconds. On the clock of a simulation, a watchdog of real seconds could not be fed.
    """

    def __init__(
        self,
        notify: NotifySocket,
        *,
        watchdog_s: float | None = None,
        starts: FailedStarts | None = None,
        trouble: Callable[[], str] = str,
        hung: Callable[[], str] = str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.trouble = trouble
        self.hung = hung
        self._notify = notify
        self._watchdog_s = watchdog_s
        self._feed_every_s = watchdog_s / FEEDS if watchdog_s else math.inf
        self._starts = starts
        self._clock = clock
        self._camera = CameraWait(starts.begin() if starts else 0)
        self._fed_s = self._told_s = -math.inf
        self._status = ""
        self._frames = 0
        self._is_ready = False

    def pause(self, sleep: Callable[[float], None] = time.sleep) -> None:
        """Wait before anything is opened, if earlier starts have failed early."""
        seconds = pause_s(self._camera.failed)
        if seconds:
            self._notify.send(f"STATUS={self._camera.failed} starts in a row failed: waiting {seconds:g} s")
            sleep(seconds)

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle: feed the watchdog, and say how things are.

        Raises:
            CaptureTimeoutError: There was no picture for so long that only a new process can help.
        """
        now_s = self._clock()
        is_hung = frame is None and bool(self.hung())
        if self._camera.is_over(now_s, has_frame=frame is not None, is_hung=is_hung):
            raise CaptureTimeoutError(self._given_up())
        if self._starts is not None and self._camera.is_proven(now_s):
            self._starts.forget()
            self._starts = None
        self._frames += frame is not None
        self._feed(now_s)
        if now_s - self._told_s >= STATUS_EVERY_S:
            self._tell_status(now_s, record.decision)

    def _feed(self, now_s: float) -> None:
        lines = [] if self._is_ready else ["READY=1"]
        if lines and self._watchdog_s is not None:  # a restart of the program has lengthened it
            lines.append(f"WATCHDOG_USEC={round(self._watchdog_s * 1e6)}")
        if now_s - self._fed_s >= self._feed_every_s < math.inf:
            lines.append("WATCHDOG=1")
        if lines and self._notify.send(*lines):  # else with the next cycle
            self._is_ready, self._fed_s = True, now_s

    def reloading(self) -> None:
        """Say that another configuration is being applied; `reloaded` follows."""
        self._notify.send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def reloaded(self) -> None:
        """Say that the configuration is applied."""
        self._notify.send("READY=1")

    def restarting(self) -> None:
        """Say that the program begins anew in this process, and may be silent for longer meanwhile."""
        self.reloading()
        self._notify.send(f"WATCHDOG_USEC={round(RESTART_WITHIN_S * 1e6)}")

    def stopping(self) -> None:
        """Say that the run ends. Its outputs were stopped."""
        self._notify.send("STOPPING=1")

    def ended_as_asked(self) -> None:
        """Note that the end was asked for: the next start has nothing to wait for."""
        if self._starts is not None:
            self._starts.forget()

    def _tell_status(self, now_s: float, decision: Decision) -> None:
        rate = f"{self._frames / (now_s - self._told_s):.0f} fps" if self._told_s > -math.inf else ""
        self._told_s, self._frames = now_s, 0
        safety = "" if decision.safety is SafetyMode.ACTIVE else f"outputs are safe: {decision.safety_reason}"
        trouble = self.trouble()
        measured = ", ".join(words for words in (*_measured(decision), rate) if words)
        status = "; ".join(words for words in (measured, safety, trouble if trouble not in safety else "") if words)
        if status != self._status and self._notify.send(f"STATUS={status}"):
            self._status = status

    def _given_up(self) -> str:
        hung = self.hung()
        waits_s = [patience_s(self._camera.failed + more, is_hung=bool(hung)) for more in (0, 1)]
        why = hung or self.trouble() or "the camera delivers none"
        return (
            f"no new picture for {waits_s[0]:g} s ({why}): the service restarts; "
            f"if that does not help, the next restart is after {waits_s[1]:g} s"
        )


def _measured(decision: Decision) -> Iterator[str]:
    for track in decision.tracks:
        is_known = track.is_valid and track.distance_m is not None
        yield f"{track.target} {track.distance_m:.2f} m" if is_known else f"{track.target} {track.status.value}"


def is_service(environ: Mapping[str, str] = os.environ) -> bool:
    """Check whether systemd expects notifications of this process's state."""
    return bool(environ.get("NOTIFY_SOCKET"))


def service(configuration: Path, environ: Mapping[str, str] = os.environ) -> Service:
    """Return this run as a service, counted as a start.

    When systemd kills a process whose loop hangs, it does so by SIGABRT: then each thread says where it hangs.
    """
    faulthandler.enable()
    folder = runtime_directory(environ)
    return Service(
        NotifySocket(environ["NOTIFY_SOCKET"]),
        watchdog_s=_watchdog_s(environ),
        starts=FailedStarts(folder, configuration) if folder is not None else None,
    )


def _watchdog_s(environ: Mapping[str, str]) -> float | None:
    """Return the period in which systemd wants to hear of us; None if it does not, or means another process."""
    period, process = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", "")
    if not period.isdecimal() or (process and process != str(os.getpid())):
        return None
    return int(period) * 1e-6 or None


NAME = "safe-outputs.conf"

FRAME_BYTES_MAX = 64
_PORT = re.compile(r"/dev/[\w./:+-]+")


def safe_outputs_path(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return where the list belongs, in the ``$RUNTIME_DIRECTORY`` of a service; None outside a service."""
    folder = runtime_directory(environ)
    return folder / NAME if folder is not None else None


def write_safe_outputs(configuration: Configuration, path: Path) -> list[str]:
    """Write the list, if it is not there already; return what is wrong, a line each."""
    real = [output for output in configuration.driven if not output.is_simulated]
    text = "".join(f"{line}\n" for output in real for line in safe_lines(output)).encode()
    try:
        if not holds(path, text):
            write_atomically(path, text)
    except OSError as error:
        return [f"{path} cannot be written, so nothing is switched off if this process is killed: {error.strerror}"]
    return []


def without_stop_from_outside(configuration: Configuration) -> list[str]:
    """Return which outputs nothing can stop once this process is killed, a line each."""
    return [
        f"{output.name}: nothing but itself stops it if this process is killed: its driver gives no bytes that do, or "
        "its port is not below /dev"
        for output in configuration.driven
        if not output.is_simulated and any(marked_options(output.options, PortMark)) and not any(safe_lines(output))
    ]


def held_lines(configuration: Configuration, environ: Mapping[str, str] = os.environ) -> list[str]:
    """Return the lines that make all real outputs safe. Of pins that exist in memory only, there is nothing to hold."""
    is_mock = environ.get("GPIOZERO_PIN_FACTORY", "").lower() == "mock"
    lines = [line for each in configuration.driven if not each.is_simulated for line in safe_lines(each)]
    return [line for line in lines if not (is_mock and line.startswith("pin "))]


def safe_lines(output: DriverChoice) -> Iterator[str]:
    """Yield the lines for one output: each of its pins, and its port or I2C bus if its driver knows what stops it."""
    off = "low" if getattr(output.options, "active_high", True) else "high"
    yield from (f"pin {pin} {off}" for _, pin in marked_options(output.options, PinMark) if isinstance(pin, int))
    stop = output.options.serial_stop() if isinstance(output.options, StopsByBytes) else None
    if stop is not None and 0 < len(stop.frame) <= FRAME_BYTES_MAX and _PORT.fullmatch(stop.port):
        yield f"serial {stop.port} {stop.baud} {stop.frame.hex()}"
    i2c = output.options.i2c_stop() if isinstance(output.options, StopsByI2c) else None
    if i2c is not None:
        yield f"i2c {i2c.bus} {i2c.address:#04x} {','.join(each.hex() for each in i2c.writes)}"
