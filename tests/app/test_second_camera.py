"""Two cameras in a run: measured together while both see, and by the first one alone whatever becomes of the second."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.app.bootstrap import build
from stadimeter.app.capture import QUIET_S, Capture, SecondCapture
from stadimeter.app.clock import SteppedClock
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, load_recorded, read_journal, to_be_recorded
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.errors import CaptureTimeoutError
from stadimeter.perception.second_camera import TOGETHER, TOGETHER_AND_SIZE
from support.replaying import replay
from support.two_cameras import BESIDE, Watched, load

GONE = 'faults = [{ at = "1 s", for = "1 s", kind = "block-second-camera" }]'


@pytest.mark.long
def test_a_target_of_unknown_size_is_measured_whatever_size_is_written(tmp_path):
    size = '=detector = "ball"\nhsv = "29,86,6:64,255,255"\ndiameter = "8 cm"\ntolerance = "unknown"'
    run = Watched(load(tmp_path, targets_ball=size), 2.0).run()
    errors, sigmas = run.errors()
    assert len(errors) > 55
    assert max(errors) < 0.01
    assert np.mean(np.array(sigmas) < 1.96) > 0.9
    assert set(run.remarks()) == {TOGETHER}


@pytest.mark.long
def test_a_wrong_size_is_said_and_the_interval_holds_all_the_same(tmp_path):
    run = Watched(load(tmp_path, targets_ball='tolerance = "0.1 mm"', world="seed = 2"), 1.0)
    run.parts.world.ball.diameter_m *= 1.08
    run.run()
    assert all("larger than stated" in remark for remark in run.remarks()[5:])
    assert max(run.errors()[1]) < 1.96


@pytest.mark.long
def test_when_the_second_camera_goes_distances_go_on_in_the_next_cycle(tmp_path):
    run = Watched(load(tmp_path, world=GONE), 3.0).run()
    times_s = [record.observation.frame.captured_at_s for record, _ in run.cycles]
    assert max(np.diff(times_s)) == pytest.approx(1 / 30, abs=1e-6)
    assert all(record.observation.measurements[0].distance_m for record, _ in run.cycles)
    faults = [
        (round(event.at_s, 1), event.kind, event.reason)
        for record, _ in run.cycles
        for event in record.decision.events
        if event.source == "second camera"
    ]
    assert faults == [
        (pytest.approx(1.0 + QUIET_S, abs=0.11), EventKind.FAULT, "the simulated second camera is blocked"),
        (pytest.approx(2.0, abs=0.11), EventKind.FAULT_CLEARED, "it works again"),
    ]
    alone = [remark for remark in run.remarks() if remark != TOGETHER_AND_SIZE]
    assert 25 <= len(alone) <= 31
    assert alone[0] == "without the second camera: pictures are 67 ms apart, limit 50 ms"
    assert run.remarks()[-1] == TOGETHER_AND_SIZE
    assert max(run.errors()[1]) < 4


@pytest.mark.long
def test_a_target_of_unknown_size_has_no_distance_while_the_second_camera_is_gone(tmp_path):
    run = Watched(load(tmp_path, targets_ball='tolerance = "unknown"', world=GONE), 2.5).run()
    blind = [record.observation for record, _ in run.cycles if record.observation.second_camera_fault]
    assert len(blind) > 15
    for observation in blind:
        (measured,) = observation.measurements
        assert measured.status is MeasurementStatus.ERROR
        assert measured.reason.startswith("its size is not known, so one camera measures no distance; without the sec")
    assert run.remarks()[-1] == TOGETHER


def test_a_second_camera_that_is_not_there_stops_no_run(tmp_path):
    absent = '=driver = "opencv"\ndevice = "/dev/no-such-camera"\nstereo = "stereo.toml"'
    run = Watched(load(tmp_path, second_camera=absent), 1.0)
    trouble = []
    run.loop.listeners.append(lambda _record, _frame: trouble.append(run.loop.trouble()))
    run.run()
    assert len(run.errors()[0]) > 25
    assert "second camera: " in trouble[-1]
    assert "/dev/no-such-camera" in trouble[-1]
    assert run.remarks()[-1] == "without the second camera: it gives no picture"


@pytest.mark.long
def test_a_recording_decides_the_same_again_to_the_last_bit(tmp_path):
    configuration = load(tmp_path, world=GONE)
    recorded = to_be_recorded(configuration)
    assert set(recorded.files) == {"stereo.toml"}
    writer = JournalWriter(tmp_path / "run.jsonl", recorded)
    Loop(build(configuration, speed=None), [writer.write]).run(Limits(seconds=2.5))
    writer.close()
    (tmp_path / "stereo.toml").unlink()
    loaded = load_recorded(recorded, tmp_path / "run.jsonl")
    assert loaded.rig == configuration.rig
    result = replay(read_journal(tmp_path / "run.jsonl"), loaded.plan)
    assert result.cycles > 70
    assert result.identical == result.cycles


def test_a_reload_notices_that_the_cameras_were_calibrated_again(tmp_path):
    before = load(tmp_path)
    assert needs_restart(before, load(tmp_path)) == ()

    again = load(tmp_path, rig=replace(BESIDE, place_m=(0.121, 0.0, 0.0)))
    assert needs_restart(before, again) == ("[second_camera.stereo]",)


class Fed(Capture):
    """Gives what it is fed."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def open(self):
        pass

    def latest(self, timeout_s):
        assert timeout_s == 0.0
        answer = self.answers.pop(0) if self.answers else CaptureTimeoutError("no new frame in 0.00 s")
        if isinstance(answer, Exception):
            raise answer
        return Frame(np.zeros((4, 4, 3), np.uint8), answer, 0)

    def trouble(self):
        return ""


def test_the_frame_that_is_nearest_in_time_is_taken():
    second = SecondCapture(Fed(0.00, 0.10, 0.20, 0.30), SteppedClock())
    assert [second.nearest(at_s).captured_at_s for at_s in (0.02, 0.04, 0.19, 0.11)] == [0.0, 0.0, 0.2, 0.1]


def test_frames_of_no_time_and_repeated_frames_are_not_taken():
    second = SecondCapture(Fed(0.1, math.nan, 0.1, 0.05), SteppedClock())
    assert [second.nearest(1.0).captured_at_s for _ in range(4)] == [0.1] * 4


def test_a_frozen_second_camera_and_a_mistake_in_its_driver_are_said():
    clock = SteppedClock()
    second = SecondCapture(Fed(0.1, 0.1, ValueError("a mistake"), 0.9), clock)
    second.open()
    second.nearest(0.1)
    clock.sleep_until_s(1.0)
    second.nearest(0.1)
    assert second.trouble() == f"no new frame for over {QUIET_S:g} s"
    second.nearest(0.1)
    assert second.trouble() == "a mistake"
    second.nearest(0.1)
    assert second.trouble() == ""
