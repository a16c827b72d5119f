"""Every range sensor keeps the contract."""

from __future__ import annotations

import math
import os
import struct
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
from gpiozero.pins.mock import MockFactory, MockPin

from stadimeter.app.clock import MonotonicClock
from stadimeter.config.plugins import SENSORS, DriverContext, load_driver
from stadimeter.errors import DriverUnavailableError
from stadimeter.gpio.output_pin import SHARED_KEY
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.rig import ManualClock, impossible
from stadimeter.testing.sensor_contract import ABSENT, NEAR_M, SILENT, SensorContract, SensorRig

SPEED_OF_SOUND_MPS = 343.26  # gpiozero's
LONGEST_PULSE_S = 0.038  # what the module gives when nothing comes back
MOMENT_S = 0.02


class EchoingPin(MockPin):
    """A trigger pin: the module behind it hears the echo, with exact times whatever the load of this computer."""

    echo_pin: MockPin | None = None
    pulse_s: float | None = None

    def _set_state(self, value: float) -> None:
        super()._set_state(value)
        if value and self.echo_pin is not None and self.pulse_s is not None:
            threading.Thread(target=self._answer, args=(self.echo_pin, self.pulse_s)).start()

    def _answer(self, echo_pin: MockPin, pulse_s: float) -> None:
        now_s = time.monotonic()
        for at_s, level in ((now_s, 1), (now_s + pulse_s, 0)):
            super(MockPin, echo_pin)._call_when_changed(at_s, level)  # the mock's own reads the time itself


class TestHcSr04(SensorContract):
    """gpiozero's thread measures in real time, so the driver's clock is the computer's."""

    @pytest.fixture
    def make_rig(self) -> Iterator[Callable[[], SensorRig]]:
        clock, factory = MonotonicClock(), MockFactory(pin_class=EchoingPin)
        context = DriverContext(name="front", clock=clock)
        context.share(SHARED_KEY, lambda: factory)
        trigger = factory.pin(23)
        trigger.echo_pin = factory.pin(24)

        def place(distance_m: float) -> None:
            trigger.pulse_s = min(2 * distance_m / SPEED_OF_SOUND_MPS, LONGEST_PULSE_S)

        def silence(begins: bool) -> None:
            trigger.pulse_s = None

        place(math.inf)
        occupy = threading.Event()
        yield lambda: SensorRig(
            device=load_driver(SENSORS, "hc-sr04")(trigger=23, echo=24).build(context),
            place=place,
            pass_time=lambda: time.sleep(MOMENT_S),
            now_s=clock.now_s,
            faults={ABSENT: lambda _: factory.reserve_pins(occupy, 24), SILENT: silence},
        )
        factory.reset()


class TestTfLuna(SensorContract):
    """Over a pseudo-terminal to which the sensor's frames are written, as it sends them."""

    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Iterator[Callable[[], SensorRig]]:
        sensor, host = os.openpty()
        tty.setraw(host)
        path, clock = tmp_path / "sensor", ManualClock()
        path.symlink_to(os.ttyname(host))
        frame = luna_frame(NEAR_M)
        is_silent = False

        def place(distance_m: float) -> None:
            nonlocal frame
            frame = luna_frame(0.0, strength=20) if math.isinf(distance_m) else luna_frame(distance_m)

        def pass_time() -> None:
            clock.advance_s(MOMENT_S)
            if not is_silent:
                os.write(sensor, frame)

        def silence(begins: bool) -> None:
            nonlocal is_silent
            is_silent = begins

        yield lambda: SensorRig(
            device=load_driver(SENSORS, "tf-luna")(port=str(path)).build(DriverContext(name="front", clock=clock)),
            place=place,
            pass_time=pass_time,
            now_s=clock.now_s,
            faults={ABSENT: lambda _: path.unlink(), SILENT: silence},
        )
        os.close(sensor)
        os.close(host)


def luna_frame(distance_m: float, strength: int = 1000) -> bytes:
    begun = b"\x59\x59" + struct.pack("<HHH", round(distance_m * 100), strength, 2300)
    return begun + bytes([sum(begun) & 0xFF])


class LibraryDouble(ModuleType):
    """The library VL53L1X, as far as the driver uses it: names and values of its version 0.0.7."""

    def __init__(self) -> None:
        super().__init__("VL53L1X")
        self.distance_mm, self.status, self.is_on_bus = 500, 0, True
        self.VL53L1X = partial(LibrarySensor, self)


class LibrarySensor:
    def __init__(self, library: LibraryDouble, i2c_bus: int = 1, i2c_address: int = 0x29) -> None:
        if not library.is_on_bus:
            raise RuntimeError(f"VL53L1X not found on adddress: {i2c_address:02x}")
        self.get_distance = lambda: library.distance_mm
        self.get_range_status = lambda: library.status

    def open(self) -> None: ...

    def start_ranging(self, mode: int) -> None: ...

    def stop_ranging(self) -> None: ...

    def close(self) -> None: ...


class TestVl53l1x(SensorContract):
    @pytest.fixture
    def make_rig(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[], SensorRig]:
        library, clock = LibraryDouble(), ManualClock()
        monkeypatch.setitem(sys.modules, "VL53L1X", library)

        def place(distance_m: float) -> None:
            library.status = 4 if math.isinf(distance_m) else 0
            library.distance_mm = -1 if math.isinf(distance_m) else round(distance_m * 1000)

        return lambda: SensorRig(
            device=load_driver(SENSORS, "vl53l1x")().build(DriverContext(name="front", clock=clock)),
            place=place,
            pass_time=lambda: clock.advance_s(MOMENT_S),
            now_s=clock.now_s,
            faults={
                ABSENT: lambda begins: setattr(library, "is_on_bus", not begins),
                SILENT: lambda _: setattr(library, "status", 5),
            },
        )


class TestSimulatedRangeSensor(SensorContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], SensorRig]:
        clock = ManualClock()
        context = DriverContext(name="front", clock=clock)
        world = context.share("world", lambda: World(WorldOptions(ball_diameter="20 cm"), clock))
        world.camera_height_m = 0.1  # the beam hits the ball in its middle

        def place(distance_m: float) -> None:
            world.faults.target_hidden = math.isinf(distance_m)
            world.place_target(0.0 if math.isinf(distance_m) else distance_m + 0.1, 0.0)
            clock.advance_s(1.0)

        return lambda: SensorRig(
            device=load_driver(SENSORS, "simulated")().build(context),
            place=place,
            pass_time=lambda: clock.advance_s(MOMENT_S),
            now_s=clock.now_s,
            faults={
                ABSENT: impossible("the simulated sensor is always there"),
                SILENT: lambda begins: setattr(world.faults, "sensors_silent", begins),
            },
        )


def test_a_library_that_is_not_installed_is_named_with_the_way_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "VL53L1X", None)
    sensor = load_driver(SENSORS, "vl53l1x")().build(DriverContext(name="front", clock=ManualClock()))
    with pytest.raises(DriverUnavailableError, match="tof"):
        sensor.open()
