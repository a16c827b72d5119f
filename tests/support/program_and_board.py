"""The real program and the emulated board of its base, each in a process of its own, with a pseudo-terminal between.

There is nothing wrong with the board until a test says so. A real board has a processor for itself: the emulated one
goes before everything else where that is allowed (root).
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Self

import numpy as np
from msgspec import Struct

from stadimeter.app.clock import MonotonicClock
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.errors import DeviceClosedError
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from support.live_rig import Detector

FRAME_S = 1 / 30
PATIENCE_S = 40.0
DEFECT = Path(os.environ.get("RIG_FOLDER", ".")) / "defect"
WIDTH_PX, HEIGHT_PX = 64, 48
STEADY = """
[camera]
driver = "steady"

[camera.model]
width_px = 64
height_px = 48
fx_px = 60.0

[targets.ball]
detector = "steady"
"""
"""A live camera and a detector that always see a ball 2 m away, so that the robot drives all the time."""

FOLLOWING = """
[base]
driver = "ros-arduino-bridge"
port = "{port}"
wheel_diameter = "65 mm"
ticks_per_turn = 1440
track_width = "16 cm"

[rules.follow]
target = "ball"
actuator = "base"
follow = {{ distance = "1 m", max_speed = "0.3 m/s", search = "off" }}
"""
ENTRY_POINTS = """
[stadimeter.cameras]
steady = support.program_and_board:SteadyCameraOptions
[stadimeter.detectors]
steady = support.program_and_board:SteadyDetectorOptions
"""


class SteadyCamera:
    """A live camera of 30 frames a second, whose picture always changes."""

    is_live = True
    remarks = ()
    not_for_motion = ""

    def __init__(self) -> None:
        self._closed = threading.Event()
        self._noise = np.random.default_rng(1)
        self._count = 0

    def open(self) -> None:
        self._closed.clear()

    def read(self) -> Frame:
        if self._closed.wait(FRAME_S):
            raise DeviceClosedError("closed")
        self._count += 1
        image = self._noise.integers(0, 256, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)  # no picture comes again
        return Frame(image=image, captured_at_s=time.monotonic(), sequence=self._count)

    def close(self) -> None:
        self._closed.set()


class SteadyDetector(Detector):
    """Fails once the file is there that stands for a defect in the program."""

    def detect(self, frame: Frame, prediction: object = None, *, lens: object = None) -> Detection:
        if DEFECT.exists():
            raise RuntimeError("a defect, as staged")
        return super().detect(frame, prediction, lens=lens)


class SteadyCameraOptions(DriverOptions):
    """No options."""

    def build(self, context: DriverContext) -> SteadyCamera:
        """Return the camera."""
        return SteadyCamera()


class SteadyDetectorOptions(DriverOptions):
    """No options."""

    def build(self, context: DriverContext) -> SteadyDetector:
        """Return the detector."""
        return SteadyDetector()


class _Board(Struct):
    """The process of the emulated board: obeys words on its standard input, a line each."""

    plugged: bool = True
    stopped_at_s: float = 0.0
    _was_driven: bool = False

    def serve(self) -> None:
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        firmware = RosArduinoFirmware(started_s=time.monotonic())
        port = EmulatedPort(firmware, MonotonicClock(), lambda: self.plugged, lambda: self._measure(firmware))
        print(port.path, flush=True)
        for line in sys.stdin:
            match line.strip():
                case "unplug" | "plug" as word:
                    self.plugged = word == "plug"
                case "silence" | "answer" as word:
                    firmware.silent = word == "silence"
                case "read":
                    port.is_read = True
                case "do not read":
                    port.is_read = False
                    _fill(port.path)
                case "report":
                    driven_mps = firmware.left.driven_mps
                    print(json.dumps({"driven_mps": driven_mps, "stopped_at_s": self.stopped_at_s}), flush=True)
        port.close()

    def _measure(self, firmware: RosArduinoFirmware) -> None:
        is_driven = firmware.left.driven_mps != 0 or firmware.right.driven_mps != 0
        if self._was_driven and not is_driven:
            self.stopped_at_s = time.monotonic()
        self._was_driven = is_driven


def _fill(path: str) -> None:
    """Fill the port up with what the firmware passes over. The kernel moves it on once more: then again."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    while _fill_once(descriptor):
        time.sleep(0.005)
    os.close(descriptor)


def _fill_once(descriptor: int) -> int:
    count = 0
    with suppress(BlockingIOError):
        while True:
            count += os.write(descriptor, b"\n" * 64)
    return count


class Rig:
    """The program and its board, each in a process of its own.

    Args:
        seconds: How long the program runs.
        camera: The tables of its camera and its ball.
        is_port_real: Whether it gets the pseudo-terminal itself and not a link to it, which stays when the cable is
            pulled. Only a device is stopped by the watchdog process.

    Attributes:
        lines: What the program says, a line each.
    """

    def __init__(self, seconds: float, camera: str = STEADY, *, is_port_real: bool = False) -> None:
        self._camera, self._is_port_real = camera, is_port_real
        self.lines: queue.Queue[str] = queue.Queue()
        self.said: list[str] = []
        self._seconds = seconds
        self._cleaning = ExitStack()

    def __enter__(self) -> Self:
        folder = Path(self._cleaning.enter_context(tempfile.TemporaryDirectory(prefix="base-under-load-")))
        self._board = self._start([sys.executable, __file__])
        port = self._answer()
        self._defect = folder / DEFECT.name
        self._write_configuration(folder, str(Path(port).resolve()) if self._is_port_real else port)
        command = [sys.executable, "-m", "stadimeter", "run", str(folder / "run.toml"), "--no-state"]
        self.program = self._start([*command, f"--seconds={self._seconds:g}", f"--socket={folder / 's'}"], folder)
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._cleaning.close()

    def tell_board(self, words: str) -> None:
        assert self._board.stdin
        self._board.stdin.write(words + "\n")
        self._board.stdin.flush()

    def fail_in_loop(self) -> None:
        """Have the detector raise an error at its next frame."""
        self._defect.touch()

    def board(self) -> dict[str, float]:
        self.tell_board("report")
        report: dict[str, float] = json.loads(self._answer())
        return report

    def wait_for(self, words: str) -> str:
        """Return the next line with these words."""
        deadline_s = time.monotonic() + PATIENCE_S
        while words not in (line := self.lines.get(timeout=max(0.0, deadline_s - time.monotonic()))):
            pass
        return line

    def faults(self) -> list[str]:
        """Return every fault of the base that was reported so far."""
        return [line for line in self.said if "safety: base fault" in line]

    def _listen(self) -> None:
        assert self.program.stdout
        with suppress(ValueError):  # it is closed while this waits for a line
            for line in self.program.stdout:
                self.said.append(line)
                self.lines.put(line)

    def _answer(self) -> str:
        assert self._board.stdout
        return self._board.stdout.readline().strip()

    def _start(self, command: Sequence[str], *python_path: Path) -> subprocess.Popen[str]:
        paths = [*python_path, Path(__file__).parents[1], *filter(None, [os.environ.get("PYTHONPATH")])]
        process = self._cleaning.enter_context(
            subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths)), "RIG_FOLDER": str(paths[0])},
            )
        )
        self._cleaning.callback(process.kill)
        return process

    def _write_configuration(self, folder: Path, port: str) -> None:
        (folder / "run.toml").write_text(self._camera + FOLLOWING.format(port=port))
        (folder / "rig-0.dist-info").mkdir()
        (folder / "rig-0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: rig\nVersion: 0\n")
        (folder / "rig-0.dist-info" / "entry_points.txt").write_text(ENTRY_POINTS)


if __name__ == "__main__":
    _Board().serve()
