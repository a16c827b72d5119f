"""The loop: everything stops first, whatever ends it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.app.bootstrap import Parts, build
from stadimeter.app.guard import LeasedOutput
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.outputs import safe_command
from stadimeter.errors import CalibrationError, DeviceOpenError, DriverError, JournalError
from support.recording_doubles import RecordingActuator, RecordingBase, RecordingMessenger
from support.simulated_run import SIMULATED_BALL

CONFIGURATION = (
    SIMULATED_BALL
    + """
[base]
driver = "simulated"
[rules.far]
actuator = "motor"
ramp = { from = "0.5 m", to = "1 m" }
[rules.follow]
actuator = "base"
follow = { distance = "1 m" }
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""
)


class Rig:
    """A loop in a simulated world, with doubles for what it drives."""

    def __init__(self, tmp_path: Path) -> None:
        path = tmp_path / "run.toml"
        path.write_text(CONFIGURATION)
        parts = build(load_configuration(path), speed=None)
        self.calls = []
        self.motor = RecordingActuator(parts.clock, "motor", self.calls)
        self.base = RecordingBase(parts.clock, "base", self.calls)
        drivers = {"motor": self.motor, "base": self.base}
        parts.outputs = tuple(
            LeasedOutput(drivers[output.name], safe_command(output), 0.3, parts.clock)
            for output in parts.configuration.plan.outputs
        )
        parts.cycle.outputs = parts.outputs
        parts.messenger = self.messenger = RecordingMessenger()
        self.parts: Parts = parts
        self.loop = Loop(parts)

    def raising(self, error: BaseException, after_s: float = 1.0):
        def listen(record, _frame):
            if record.observation.now_s >= after_s:
                raise error

        self.loop.listeners.append(listen)

    @property
    def last_actions(self):
        """What was done to the outputs, from the first stop on."""
        actions = [(call.device, call.action) for call in self.calls]
        return actions[actions.index(("motor", "stop")) :]


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


STOPPED_THEN_CLOSED = [
    ("motor", "stop"),
    ("base", "stop"),
    ("base", "stop"),
    ("base", "close"),
    ("motor", "stop"),
    ("motor", "close"),
]


def test_a_run_moves_its_outputs_and_then_stops_them_before_anything_is_closed(rig):
    rig.loop.run(Limits(seconds=1))
    assert rig.motor.commands[-1].level == 1.0
    assert rig.base.commands[-1].linear_mps > 0.2
    assert rig.last_actions == STOPPED_THEN_CLOSED
    assert rig.loop.ending == "1 s, as asked for"


@pytest.mark.parametrize(
    "error",
    [
        ZeroDivisionError("a defect"),
        CalibrationError("another aspect"),
        JournalError("the disk is full"),
        MemoryError("2 GB"),
        SystemExit("a library"),
    ],
)
def test_an_error_anywhere_stops_every_output_and_is_then_reported(rig, error):
    rig.raising(error)
    with pytest.raises(type(error), match=str(error)):
        rig.loop.run()
    assert rig.last_actions == STOPPED_THEN_CLOSED
    assert not rig.messenger.is_open


def test_an_error_in_a_detector_stops_every_output_too(rig):
    class Broken:
        target_shape = rig.parts.cycle.detectors["ball"].target_shape

        def detect(self, frame, prediction=None, *, lens=None):
            if frame.sequence > 10:
                raise IndexError("a defect in a detector")
            return working.detect(frame, prediction, lens=lens)

    working = rig.parts.cycle.detectors["ball"]
    rig.parts.cycle.perceiver.detectors = {"ball": Broken()}
    with pytest.raises(IndexError):
        rig.loop.run()
    assert rig.last_actions == STOPPED_THEN_CLOSED


def test_outputs_that_cannot_be_opened_are_all_named_and_what_was_open_is_closed(rig):
    rig.motor.fail_with, rig.motor.fail_on = DeviceOpenError("pin 18 is in use"), ("open",)
    rig.base.fail_with, rig.base.fail_on = DeviceOpenError("/dev/ttyUSB0 is absent"), ("open",)
    with pytest.raises(DriverError) as raised:
        rig.loop.run()
    assert str(raised.value) == "motor: pin 18 is in use\nbase: /dev/ttyUSB0 is absent"
    assert not rig.messenger.is_open


def test_after_stop_no_command_moves_anything(rig):
    def listen(record, _frame):
        if record.observation.now_s >= 1.0:
            rig.loop.stop("because")
            assert rig.motor.level == 0.0
            assert rig.base.linear_mps == 0.0

    rig.loop.listeners.append(listen)
    rig.loop.run()
    assert rig.loop.ending == "because"
    assert rig.last_actions[:2] == [("motor", "stop"), ("base", "stop")]
    assert ("base", "apply") not in rig.last_actions


def test_a_stop_that_fails_is_told_and_the_others_stop_all_the_same(rig):
    def listen(record, _frame):
        if record.observation.now_s >= 1.0:
            rig.motor.fail_with, rig.motor.fail_on = DriverError("burnt out"), ("stop",)

    rig.loop.listeners.append(listen)
    rig.loop.run(Limits(seconds=1.2))
    assert "motor: burnt out" in rig.loop.troubles
    assert rig.base.stop_times_s


SCRIPT = """
import os, sys
from pathlib import Path

sys.path.insert(0, sys.argv[2])
from test_loop import Rig
from stadimeter.app.ending import stopping_on_signals

rig = Rig(Path(sys.argv[1]))

def listen(record, _frame):
    if 1.0 <= record.observation.now_s < 1.1:
        os.kill(os.getpid(), int(sys.argv[3]))

rig.loop.listeners.append(listen)
with stopping_on_signals(rig.loop.stop):
    rig.loop.run()
print(rig.loop.ending, rig.last_actions[:2])
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_every_output_first_and_ends_the_run_in_order(tmp_path, number):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path), str(Path(__file__).parent), str(int(number))],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(signal.Signals(number).name)
    assert "[('motor', 'stop'), ('base', 'stop')]" in done.stdout
