"""A whole run with a live camera on the computer's clock: capture thread, guard threads and signals together."""

import os
import signal
import threading

import pytest

from stadimeter.app import ending
from stadimeter.app.ending import stopping_on_signals
from stadimeter.app.guard import RESTING
from stadimeter.app.loop import Limits
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.errors import DeviceOpenError, DriverError, DriverUnavailableError
from support.live_rig import Rig
from support.picamera2_double import Sensor


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


def test_a_camera_that_blocks_puts_the_output_at_its_safe_value_and_the_run_goes_on(rig):
    def listen(record, _frame):
        if rig.loop.history.frames >= 20 and record.decision.safety == "active":
            rig.camera.blocked.set()
        # A busy machine may have stood still before: then that is the reason at first.
        if rig.camera.blocked.is_set() and record.decision.safety_reason.startswith("the newest frame is "):
            assert record.decision.safety == "stale"
            assert rig.motor.level == 0.0
            rig.loop.stop("it was noticed")

    rig.loop.listeners.append(listen)
    rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "it was noticed"


class Supervised:
    """What a run needs to be a service; it is in no other way watched."""

    def __call__(self, *_):
        pass

    reloading = reloaded = stopping = __call__


@pytest.mark.long
def test_a_service_begins_without_its_devices_and_opens_them_when_they_are_there(rig):
    rig.loop.services.service = Supervised()
    open_camera = rig.camera.open
    tries = []

    def open_later():
        tries.append(rig.clock.now_s())
        if len(tries) < 3:
            raise DeviceOpenError("there is no camera")
        open_camera()

    rig.camera.open = open_later
    rig.motor.fail_with, rig.motor.fail_on = DeviceOpenError("there is no motor"), ("open",)
    seen = []

    def listen(record, _frame):
        seen.append({fault.reason for fault in record.observation.output_faults})
        if rig.loop.history.frames == 1:
            rig.motor.fail_with = None
        if rig.motor.level > 0:
            rig.loop.stop("it acts")

    rig.loop.listeners.append(listen)
    rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "it acts"
    assert seen[0] == {"there is no motor"}
    assert RESTING in set().union(*seen), "someone may have just plugged it in"


def test_a_service_does_not_begin_without_what_shall_stay_off_or_can_never_be_there(rig):
    rig.loop.services.service = Supervised()
    rig.camera.open = _failing(DriverUnavailableError("picamera2 is not installed"))
    rig.motor.fail_with, rig.motor.fail_on = DeviceOpenError("there is no motor"), ("open",)
    (output,) = rig.loop.parts.outputs
    output._stays_off = True
    with pytest.raises(DriverError) as caught:
        rig.loop.run(Limits(seconds=1))
    assert str(caught.value).splitlines() == ["motor: there is no motor", "camera: picamera2 is not installed"]


def _failing(error):
    def fail():
        raise error

    return fail


def test_a_pi_camera_that_hangs_stops_the_output_and_drives_it_again_with_its_settings_when_it_is_back(tmp_path):
    sensors = []

    def pi_camera(clock):
        sensors.append(Sensor(clock))
        table = {"width_px": 64, "height_px": 48, "rate": "100 Hz", "read_timeout": "100 ms", "exposure": "2 ms"}
        return Picamera2Camera(Picamera2Options.model_validate(table), clock, sensors[0].package, clock.now_s)

    rig = Rig(tmp_path, pi_camera)
    (sensor,) = sensors
    while_silent = []

    def listen(record, _frame):
        if sensor.is_silent:
            while_silent.extend([rig.motor.level] if record.decision.safety == "stale" else [])
            sensor.is_silent = not (while_silent and len(sensor.configurations) > opened[-1])
        elif rig.motor.level > 0 and not while_silent:
            opened.append(len(sensor.configurations))
            sensor.is_silent = True
        elif rig.motor.level > 0:
            rig.loop.stop("it is back")

    opened = []
    rig.loop.listeners.append(listen)
    rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "it is back"
    assert set(while_silent) == {0.0}
    assert sensor.configurations[-1]["controls"] == sensor.configurations[0]["controls"]


def test_a_signal_ends_it_with_everything_stopped(rig):
    def listen(_record, _frame):
        if rig.loop.history.frames == 10:
            os.kill(os.getpid(), signal.SIGTERM)

    rig.loop.listeners.append(listen)
    with stopping_on_signals(rig.loop.stop):
        rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "SIGTERM"
    assert rig.motor.level == 0.0
    assert not rig.motor.is_open


def test_being_asked_to_end_before_anything_is_open_opens_nothing(rig):
    rig.loop.stop("SIGTERM")
    rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "SIGTERM"
    assert not rig.motor.commands
    assert rig.loop.history.cycles == 0


@pytest.mark.long
def test_a_camera_that_does_not_let_go_is_left_behind_and_the_output_is_closed(rig, monkeypatch):
    monkeypatch.setattr(ending, "END_WITHIN_S", 1.5)
    let_go = threading.Event()
    rig.camera.close = lambda: let_go.wait(120)
    rig.loop.listeners.append(lambda *_: rig.loop.stop("SIGTERM") if rig.loop.history.frames == 10 else None)
    rig.loop.run(Limits(seconds=120))
    assert rig.loop.troubles == ["camera: it did not end in time, and was left behind"]
    assert not rig.motor.is_open
    rig.camera.closed.set()
    let_go.set()


def test_being_asked_to_end_while_a_device_opens_breaks_that_off(rig):
    def slow_open():
        os.kill(os.getpid(), signal.SIGINT)
        threading.Event().wait(120)

    rig.camera.open = slow_open
    with stopping_on_signals(rig.loop.stop):
        rig.loop.run(Limits(seconds=120))
    assert rig.loop.ending == "SIGINT"
    assert rig.loop.history.frames == 0
    assert not rig.motor.is_open
