"""The health of a run and its board, in figures and in words.

Sources: ``/sys/class/thermal`` (Linux documentation); the bits of ``vcgencmd get_throttled`` are those of Raspberry
Pi's documentation, "Raspberry Pi OS", section ``get_throttled``. The kernel of Raspberry Pi OS gives the same number,
in hexadecimal, in a file of its firmware driver.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from msgspec import Struct, field

if TYPE_CHECKING:  # it loads numpy, and `doctor` looks at the board before it knows whether that loads
    from stadimeter.app.live.history import RunHistory
    from stadimeter.core.camera_pose import CameraPose, Mounting

# From here on a Raspberry Pi slows its processor; a 3B+ from 60 °C.
THERMAL = "sys/class/thermal/thermal_zone0/temp"
THROTTLED = "sys/bus/platform/drivers/raspberrypi-firmware/*/get_throttled"
HOT_C = 70.0

# The same bits, this much higher, stay set from their first time until the next start.
THROTTLED_BITS = {0: "under-voltage", 1: "its clock is capped", 2: "throttled", 3: "slowed by heat"}
SINCE_START = 16

# The package's installation writes it if a version fails its self-test: a sentence that says which, and why.
FAILED_UPGRADE = "opt/stadimeter/current/failed-upgrade"

# The board is looked at this often: its files take up to a millisecond each, and nothing there changes faster.
LOOK_EVERY_S = 5.0

# With less room than this, recordings and logs come to an end soon.
DISK_FREE_MIN_BYTES = 200e6

# A picture older than this is no longer a live one.
OLD_S = 0.5

# Times are of this many of the newest frames: ten seconds of a camera.
LATEST = 300

# Below this share of its speed, a simulation or a recording is slow for all who watch it.
SLOW_PACE = 0.9


class Note(NamedTuple):
    """One thing about a run's health, in words."""

    what: str
    words: str
    is_good: bool = True


class BoardState(NamedTuple):
    """State of a board as it says itself; None where it does not."""

    temperature_c: float | None = None
    throttling: tuple[str, ...] = ()
    disk_free_bytes: int | None = None
    memory_bytes: int | None = None
    failed_upgrade: str = ""


class Board(Struct):
    """Looks at the board now and then.

    Attributes:
        folder: Where the run writes; its free space is reported.
        root: The root of the file system, for tests.
    """

    folder: Path = field(default_factory=Path)
    root: Path = Path("/")
    clock: Callable[[], float] = time.monotonic
    _state: BoardState = field(default_factory=BoardState)
    _look_at_s: float = float("-inf")

    def state(self) -> BoardState:
        """Return the state that the board reported lately."""
        if self.clock() >= self._look_at_s:
            self._look_at_s = self.clock() + LOOK_EVERY_S
            self._state = BoardState(
                temperature_c=temperature_c(self.root),
                throttling=throttled_now(self.root),
                disk_free_bytes=_disk_free_bytes(self.folder),
                memory_bytes=_memory_bytes(self.root),
                failed_upgrade=_failed_upgrade(self.root),
            )
        return self._state


class LiveHealth(Struct, frozen=True, kw_only=True):
    """The health of a run.

    Attributes:
        frame_rate_hz: Frames a second, of late; 0 if none came. In real time, where the run falls behind its speed.
        pace: How fast a simulation or a recording passes, as a share of the speed that was asked for; else 1.
        frame_age_s: Age of the newest frame in the newest cycle; None before the first.
        latency_s: From the capture of a frame until its commands had been applied, median of late.
        latency_p95_s: Its 95th percentile.
        cycle_s: The computing time of a cycle, median and 95th percentile of late.
        dropped_frames: How many frames the camera delivered that no cycle took.
        broker: How the link to the broker is; empty if there is none.
        trouble: A fault outside the loop; empty if there is none.
        place: Where the camera is, or why that is not known; None where no tags of known places tell.
        mounting: Whether the camera is still as it was saved; None where that is not watched.
    """

    frame_rate_hz: float = 0.0
    pace: float = 1.0
    frame_age_s: float | None = None
    latency_s: float | None = None
    latency_p95_s: float | None = None
    cycle_s: tuple[float | None, float | None] = (None, None)
    dropped_frames: int = 0
    board: BoardState = field(default_factory=BoardState)
    broker: str = ""
    trouble: str = ""
    place: CameraPose | None = None
    mounting: Mounting | None = None

    @property
    def notes(self) -> tuple[Note, ...]:
        """All of it in words, the most important first."""
        return (*self._of_frames(), *self._of_board(), *self._of_others())

    @property
    def warnings(self) -> tuple[str, ...]:
        """The faults of the board, and those outside the loop, in words."""
        board = [f"{note.what}: {note.words}" for note in self._of_board() if not note.is_good]
        return (*board, *([self.trouble] if self.trouble else []))

    def _of_frames(self) -> Iterator[Note]:
        if self.frame_age_s is None:
            yield Note(what="camera", words="no picture yet", is_good=False)
        else:
            words = f"{self.frame_rate_hz:.1f} pictures a second, {_age(self.frame_age_s)} old"
            yield Note(what="camera", words=words, is_good=self.frame_age_s < OLD_S)
        if self.pace < SLOW_PACE:
            words = f"{self.pace:.0%} of the speed asked for: this computer cannot keep up"
            yield Note(what="pace", words=words, is_good=False)
        if self.latency_s is not None:
            yield Note(what="latency", words=f"median {_age(self.latency_s)} to the outputs")
        median_s, p95_s = self.cycle_s
        if median_s is not None and p95_s is not None:
            words = f"median {median_s * 1e3:.1f} ms, p95 {p95_s * 1e3:.1f} ms"
            yield Note(what="cycle time", words=words)
        if self.place is not None:
            yield Note(what="place", words=self.place.in_words(), is_good=self.place.position_m is not None)
        if self.mounting is not None:
            status = self.mounting.status.value.replace("_", " ")
            words = f"{status}: {self.mounting.reason}" if self.mounting.reason else status
            yield Note(what="mounting", words=words, is_good=not self.mounting.is_unconfirmed)
        words = "none" if not self.dropped_frames else f"{self.dropped_frames} since the start"
        yield Note(what="dropped frames", words=words)

    def _of_board(self) -> Iterator[Note]:
        board = self.board
        if board.temperature_c is not None:
            is_hot = board.temperature_c >= HOT_C
            words = f"{board.temperature_c:.0f} °C{', cool it' if is_hot else ''}"
            yield Note(what="processor", words=words, is_good=not is_hot)
        if board.throttling:
            yield Note(what="supply and heat", words=", ".join(board.throttling), is_good=False)
        if board.disk_free_bytes is not None:
            has_room = board.disk_free_bytes >= DISK_FREE_MIN_BYTES
            yield Note(what="disk", words=f"{_bytes(board.disk_free_bytes)} free", is_good=has_room)
        if board.memory_bytes is not None:
            yield Note(what="memory", words=f"{_bytes(board.memory_bytes)} in use by this run")

    def _of_others(self) -> Iterator[Note]:
        if self.broker:
            yield Note(what="broker", words=self.broker, is_good=self.broker == CONNECTED)
        if self.trouble:
            yield Note(what="trouble", words=self.trouble, is_good=False)


CONNECTED = "connected"


def live_health(history: RunHistory, board: Board, broker: str, trouble: str, pace: float = 1.0) -> LiveHealth:
    """Return the health of a run now."""
    cycle_s, latency_s = _latest(history.cycle_times_s), _latest(history.data_ages_s)
    state = board.state()
    return LiveHealth(
        frame_rate_hz=history.frame_rate_hz * (pace if pace < SLOW_PACE else 1.0),
        pace=pace,
        frame_age_s=history.frame_age_s,
        latency_s=percentile(latency_s, 0.5),
        latency_p95_s=percentile(latency_s, 0.95),
        cycle_s=(percentile(cycle_s, 0.5), percentile(cycle_s, 0.95)),
        dropped_frames=history.dropped_frames,
        board=state,
        broker=broker,
        trouble="; ".join(filter(None, (trouble, state.failed_upgrade))),
        place=None if history.seen is None else history.seen.record.observation.camera_pose,
        mounting=None if history.seen is None else history.seen.record.observation.mounting,
    )


def _latest(values: Iterable[float]) -> list[float]:
    return sorted(list(values)[-LATEST:])


def _age(seconds: float) -> str:
    return f"{seconds * 1e3:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _disk_free_bytes(folder: Path) -> int | None:
    try:
        found = os.statvfs(folder)
    except OSError:
        return None
    return found.f_bavail * found.f_frsize


def _memory_bytes(root: Path) -> int | None:
    try:
        pages = (root / "proc/self/statm").read_text("ascii").split()[1]
    except (OSError, IndexError):
        return None
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _failed_upgrade(root: Path) -> str:
    try:
        return (root / FAILED_UPGRADE).read_text("utf-8", "replace").strip()
    except OSError:
        return ""


def percentile(ordered: Sequence[float], share: float) -> float | None:
    """Return the value that this share (0 to 1) of the values does not exceed; None if there are none."""
    if not ordered:
        return None
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def peak_memory_mb() -> float:
    """Return the most memory that this program has had, in 10⁶ bytes.

    Not from `resource`: that counts the memory of the process which started this one, if it had more.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6


class Throttling(NamedTuple):
    """The firmware's words on supply and heat: at this moment, and at any time since the start."""

    now: tuple[str, ...]
    before: tuple[str, ...]


def throttling(bits: int) -> Throttling:
    """Return the meaning of the number of ``vcgencmd get_throttled``."""
    return Throttling(
        now=tuple(words for bit, words in THROTTLED_BITS.items() if bits >> bit & 1),
        before=tuple(words for bit, words in THROTTLED_BITS.items() if bits >> (bit + SINCE_START) & 1),
    )


def throttled_now(root: Path = Path("/")) -> tuple[str, ...]:
    """List the faults of supply and heat at this moment, as far as the kernel says; starts no program."""
    for file in sorted(root.glob(THROTTLED)):
        try:
            return throttling(int(file.read_text("ascii"), 16)).now
        except (OSError, ValueError):
            continue
    return ()


def temperature_c(root: Path = Path("/")) -> float | None:
    """Return the temperature of the processor; None where the kernel does not say."""
    try:
        return int((root / THERMAL).read_text("ascii")) / 1000
    except (OSError, ValueError):
        return None
