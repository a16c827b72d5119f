"""Parts that the emulated firmware of every base shares: wheels, time-out, and its place in the simulated world.

An emulator is one file: a class derived from `EmulatedFirmware`, and one derived from `EmulatedBoardOptions` that names
it, with its entry ``emulated-…`` in ``stadimeter.ports``.
"""

from __future__ import annotations

import contextlib
import math
import os
import pty
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceOpenError
from stadimeter.simulation.world import World, shared_world

# A serial port with an emulated microcontroller behind it -------------------------------------------------------------
#
# The port is a pseudo-terminal, so the driver under it opens, locks and reads it as it would a real one. A pseudo-
# terminal has no baud rate, no DTR that resets a board, and no bit errors: only bytes can be tried on it.

SERVED_EVERY_S = 0.01
_MAX_BYTES_PER_READ = 4096


class EmulatedPort:
    """A pseudo-terminal whose other end an emulated firmware serves, each ``every_s`` of the run's clock.

    Its path stays the same when the cable is pulled and plugged in again, as below ``/dev/serial/by-id``. It may be
    used from several threads: a real clock serves it from one of its own.

    Args:
        firmware: The program behind the port. Its board has its own power and lives on without the cable.
        is_plugged: Asked at each service whether the cable is in.
        after_step: Called after each service; moves what the firmware drives.
        every_s: The time between two services.

    Raises:
        OSError: The system has no pseudo-terminal left.
    """

    def __init__(
        self,
        firmware: EmulatedFirmware,
        clock: Clock,
        is_plugged: Callable[[], bool] = lambda: True,
        after_step: Callable[[], None] = lambda: None,
        *,
        every_s: float = SERVED_EVERY_S,
    ) -> None:
        # Fault if False: nothing is read at the board's end, so that the port fills up and takes no more bytes.
        self.is_read = True
        self.is_full = False  # fault: so it is at once, and whatever room comes is filled
        self.is_heard = True  # fault if False: what the board answers is lost on the way
        self.spoil: Callable[[bytes], bytes] = bytes  # fault: what the board gets instead of what was sent
        self._firmware = firmware
        self._is_plugged = is_plugged
        self._after_step = after_step
        self._lock = threading.Lock()
        self._cable: _Cable | None = None
        self._folder = TemporaryDirectory(prefix="stadimeter-port-")
        self._link = Path(self._folder.name) / "emulated"
        self._plug_in()
        self._cancel = clock.call_every(every_s, self.serve)

    @property
    def path(self) -> str:
        """The path that a host opens. There is nothing there while the cable is out."""
        return str(self._link)

    def serve(self, now_s: float) -> None:
        """Let the firmware live until now, carry bytes both ways, and move what it drives."""
        with self._lock:
            self._firmware.step(now_s)
            self._follow_the_cable()
            if self._cable and self.is_full:
                self._cable.fill()
            elif self._cable and self.is_read:
                answer = self._firmware.receive(self.spoil(self._cable.read()), now_s)
                if answer and self.is_heard:
                    self._cable.write(answer)
            self._after_step()

    def say(self, data: bytes) -> None:
        """Send bytes to the host that it did not ask for: a boot loader's, or noise; lost while the cable is out."""
        with self._lock:
            if self._cable:
                self._cable.write(data)

    def close(self) -> None:
        """End the service and give the pseudo-terminal back. May be called any number of times."""
        self._cancel()
        with self._lock:
            self._pull_out()
            self._folder.cleanup()

    def _follow_the_cable(self) -> None:
        if self._is_plugged() and not self._cable:
            self._plug_in()
        elif self._cable and not self._is_plugged():
            self._pull_out()

    def _plug_in(self) -> None:
        self._cable = _Cable()
        self._link.symlink_to(self._cable.host_path)

    def _pull_out(self) -> None:
        if self._cable:
            self._link.unlink()
            self._cable.close()
            self._cable = None


class _Cable:
    """A pseudo-terminal: one end for the board, one for the host. Closing it hangs up on the host."""

    def __init__(self) -> None:
        # The host's end stays open here too: without any opener the system would forget that it is raw, and echo.
        self._board_fd, self._host_fd = pty.openpty()
        tty.setraw(self._host_fd)
        os.set_blocking(self._board_fd, False)
        os.set_blocking(self._host_fd, False)
        self.host_path = os.ttyname(self._host_fd)

    def read(self) -> bytes:
        """Read the bytes that the host has sent, which may be none."""
        try:
            return os.read(self._board_fd, _MAX_BYTES_PER_READ)
        except BlockingIOError:
            return b""

    def fill(self) -> None:
        """Fill the way from the host to the board with empty lines, which firmware passes over."""
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(self._host_fd, b"\n" * 64)

    def write(self, data: bytes) -> None:
        """Send what fits. As on a wire, what a host does not read in time is lost."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._board_fd, data)

    def close(self) -> None:
        """Give both ends back."""
        os.close(self._board_fd)
        os.close(self._host_fd)


# Under this name a run keeps its emulated board, so that its faults can be reached.
SHARED_NAME = "emulated port"

TIME_CONSTANT_S = 0.1

_NO_LAG_MPS = 1e-6


class EmulatedWheel:
    """A wheel with an encoder, which approaches the speed that it is driven at."""

    def __init__(self) -> None:
        self.driven_mps = 0.0  # the speed that its motor is driven at
        self.speed_mps = 0.0  # the speed that it has
        self.rolled_m = 0.0

    def turn(self, seconds: float, time_constant_s: float = TIME_CONSTANT_S) -> None:
        """Turn for that long: the exact solution of a first-order lag under a constant drive."""
        kept = math.exp(-seconds / time_constant_s)
        lag_mps = self.speed_mps - self.driven_mps
        self.rolled_m += self.driven_mps * seconds + lag_mps * time_constant_s * (1 - kept)
        self.speed_mps = self.driven_mps + (lag_mps * kept if abs(lag_mps) > _NO_LAG_MPS else 0.0)


class EmulatedFirmware:
    """The program of a board with two wheels, as a function of bytes and time.

    A subclass says what bytes do, in `_take`, and calls `_drive` for a command to the motors.

    Attributes:
        silent: Fault: bytes from the host are lost, and nothing is sent. Motors and the time-out work on.
        timeout_s: The motors stop when no command came for this long; infinity for never.
        battery_v: The voltage that it reports.
        left, right: The wheels.
        served_every_s: How often the board looks at its line.
        takes_timeout: Whether a command sets the time-out; else it is built in.
    """

    served_every_s: ClassVar[float] = SERVED_EVERY_S
    takes_timeout: ClassVar[bool] = False

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        self.silent = False
        self.timeout_s = math.inf
        self.battery_v = 12.0
        self.left = EmulatedWheel()
        self.right = EmulatedWheel()
        self.ticks_per_metre = ticks_per_metre
        self._now_s = started_s
        self._times_out_s = math.inf

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host, which may be none, and return what the board sends."""
        self.step(now_s)
        if self.silent:
            return b""
        return self._take(data) + self._unasked()

    def step(self, now_s: float) -> None:
        """Live until that time: turn the wheels, stop by itself."""
        if self._times_out_s <= now_s:
            self._turn_until(self._times_out_s)
            self._time_out()
        self._turn_until(now_s)

    def _take(self, data: bytes) -> bytes:
        """Return the answers to bytes from the host."""
        raise NotImplementedError(f"{type(self).__name__} takes no bytes")

    def _unasked(self) -> bytes:
        """Return the bytes the board sends by itself by now."""
        return b""

    def _drive(self, left_mps: float, right_mps: float) -> None:
        """Drive the motors, and let the time-out begin anew."""
        self.left.driven_mps, self.right.driven_mps = left_mps, right_mps
        self._feed_timeout()

    def _feed_timeout(self) -> None:
        self._times_out_s = self._now_s + self.timeout_s

    def _time_out(self) -> None:
        self.left.driven_mps = self.right.driven_mps = 0.0
        self._times_out_s = math.inf

    def _turn_until(self, time_s: float) -> None:
        seconds = max(0.0, time_s - self._now_s)
        for wheel in (self.left, self.right):
            wheel.turn(seconds)
        self._now_s += seconds


# Makes a firmware that starts at a time, for a robot whose encoders count so many ticks on a metre.
MakeFirmware = Callable[[float, float], EmulatedFirmware]


class EmulatedBoard:
    """The emulated board in the simulated world: its motors turn the robot's wheels, its cable can be pulled.

    Raises:
        DeviceOpenError: The system has no pseudo-terminal left.
    """

    def __init__(self, make_firmware: MakeFirmware, world: World, clock: Clock) -> None:
        self._world = world
        # The board, with its own knobs for faults. The cable's is ``world.faults.base_unplugged``.
        self.firmware = make_firmware(clock.now_s(), world.robot.ticks_per_metre)
        try:
            # Where a driver finds it.
            self.port = EmulatedPort(
                self.firmware, clock, self._is_plugged, self._turn_wheels, every_s=self.firmware.served_every_s
            )
        except OSError as error:
            raise DeviceOpenError(f"no pseudo-terminal for the emulated base: {error}") from error

    def _is_plugged(self) -> bool:
        return not self._world.faults.base_unplugged

    def _turn_wheels(self) -> None:
        self._world.robot.drive_wheels(self.firmware.left.speed_mps, self.firmware.right.speed_mps)


class EmulatedBoardOptions(DriverOptions):
    """An emulated port has no table in the configuration: a base names it as its port."""

    firmware: ClassVar[MakeFirmware]

    @classmethod
    def board(cls, context: DriverContext) -> EmulatedBoard:
        """Return the run's emulated board, which the run closes; the first to ask connects it to the world's robot.

        Raises:
            ConfigError: The run has no world.
            DeviceOpenError: The system has no pseudo-terminal left.
        """

        def connect() -> EmulatedBoard:
            board = EmulatedBoard(cls.firmware, shared_world(context), context.clock)
            context.at_end(board.port.close)
            return board

        return context.share(SHARED_NAME, connect)

    def build(self, context: DriverContext) -> str:
        """Return the path of the pseudo-terminal."""
        return self.board(context).port.path
