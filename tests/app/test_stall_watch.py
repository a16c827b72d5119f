"""The watch on real time for recordings that drive real outputs."""

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.guard import Guard, LeasedOutput, StallWatch
from stadimeter.config.loader import load_configuration
from stadimeter.core.command import LevelCommand
from stadimeter.testing.rig import ManualClock
from support.recording_doubles import RecordingActuator
from support.simulated_run import SIMULATED_BALL

BASE = """
[base]
driver = "ros-arduino-bridge"
port = "{port}"
wheel_diameter = "6 cm"
ticks_per_turn = 800
track_width = "20 cm"
"""


@pytest.fixture
def rig():
    recording, real = ManualClock(), ManualClock()
    motor = RecordingActuator(recording, "motor")
    output = LeasedOutput(motor, LevelCommand(output="motor", level=0.0), 0.3, recording)
    output.open()
    watch = StallWatch([output], recording, real)
    watch.start()
    output.apply(LevelCommand(output="motor", level=1.0, captured_at_s=recording.now_s()))
    return recording, real, motor, output, watch


def test_an_output_goes_to_its_safe_value_when_the_loop_hangs(rig):
    _, real, motor, _, watch = rig
    real.advance_s(0.4)
    assert motor.level == 1.0
    real.advance_s(0.3)
    assert motor.level == 0.0
    watch.end_watching()


def test_as_long_as_the_recording_moves_nothing_is_done(rig):
    recording, real, motor, output, _ = rig
    for _ in range(50):
        recording.advance_s(0.03)
        real.advance_s(0.1)
        output.apply(LevelCommand(output="motor", level=1.0, captured_at_s=recording.now_s()))
    assert motor.level == 1.0


def test_a_loop_that_goes_on_may_act_again(rig):
    recording, real, motor, output, _ = rig
    real.advance_s(2.0)
    recording.advance_s(0.03)
    output.apply(LevelCommand(output="motor", level=1.0, captured_at_s=recording.now_s()))
    real.advance_s(0.1)
    assert motor.level == 1.0


@pytest.mark.parametrize(
    ("text", "real"),
    [
        ("", ()),
        ('[actuators.buzzer]\ndriver = "buzzer"\npin = 23\n', ("buzzer",)),
        (BASE.format(port="emulated-ros-arduino-bridge"), ()),
        (BASE.format(port="/dev/ttyUSB0"), ("base",)),
    ],
)
def test_only_outputs_outside_the_simulated_world_need_it(tmp_path, text, real):
    path = tmp_path / "run.toml"
    path.write_text(SIMULATED_BALL + text + "[world]\n")
    assert build(load_configuration(path), speed=None).recording_drives == real


@pytest.mark.parametrize("defect", [ZeroDivisionError, SystemExit])
def test_a_defect_in_one_driver_stops_every_output_and_does_not_end_the_watch(defect):
    recording, real = ManualClock(), ManualClock()
    drivers = [RecordingActuator(recording, name) for name in ("a", "b")]
    outputs = [LeasedOutput(each, LevelCommand(output="it", level=0.0), 9.0, recording) for each in drivers]
    for output in outputs:
        output.open()
    guard = Guard(outputs, recording)
    watch = StallWatch(outputs, recording, real, guard)
    watch.start()
    outputs[1].apply(LevelCommand(output="it", level=1.0, captured_at_s=recording.now_s()))
    drivers[0].fail_with = defect()
    real.advance_s(1.0)
    assert isinstance(guard.failure, defect)
    assert drivers[1].stop_times_s
