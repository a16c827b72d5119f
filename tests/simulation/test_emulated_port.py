from __future__ import annotations

import gc
import os
from pathlib import Path

from stadimeter.app.clock import MonotonicClock
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from stadimeter.testing.rig import ManualClock


def open_files() -> set[Path]:
    gc.collect()  # what other tests left is closed now, and not in between
    return set(Path("/proc/self/fd").iterdir())


def test_closing_gives_everything_back_and_may_be_done_twice() -> None:
    before, clock = open_files(), ManualClock()
    port = EmulatedPort(RosArduinoFirmware(), clock)
    folder = Path(port.path).parent
    port.close()
    port.close()
    clock.advance_s(1.0)
    assert open_files() == before
    assert not folder.exists()


def test_on_a_real_clock_the_port_is_served_from_a_thread() -> None:
    clock = MonotonicClock()
    port = EmulatedPort(RosArduinoFirmware(started_s=clock.now_s()), clock)
    host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, b"b\r")
    answer = b""
    while not answer.endswith(b"\n"):
        answer += os.read(host, 100)
    os.close(host)
    port.close()
    assert answer == b"57600\r\n"
