"""Recording beside the loop: what the disk does never holds up a run."""

import math
import threading

import numpy as np
import pytest

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.ending import Deadline
from stadimeter.app.recordings import recorder as recorder_module
from stadimeter.app.recordings.journal import RecordedConfiguration
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.core.frame import Frame
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.errors import JournalError
from support.observing import Rehearsal


class Gate:
    """A writer whose disk waits until it is let go on, or fails."""

    kind = "recording"
    takes_pictures = True

    def __init__(self, failure=None):
        self.go_on = threading.Event()
        self.written = []
        self.failure = failure
        self.is_closed = self.is_abandoned = False

    def write(self, record, frame):
        self.go_on.wait()
        if self.failure:
            raise self.failure
        self.written.append((record, frame))

    def note_reload(self, _now_s, configuration):
        self.written.append(configuration)

    def close(self):
        self.is_closed = True

    def abandon(self):
        self.is_abandoned = True


RECORD = CycleRecord(
    observation=Observation(now_s=1.0), decision=Rehearsal(Plan(targets=("ball",))).see(2.0), applied=(), timings_s={}
)
FRAME = Frame(np.zeros((48, 64, 3), np.uint8), 1.0, 0)


def test_on_a_live_camera_a_slow_disk_costs_pictures_and_no_cycles():
    gate = Gate()
    recorder = Recorder(gate, is_live=True)
    for _ in range(100):
        recorder(RECORD, FRAME)
    assert recorder.images_left_out >= 80
    assert "pictures are left out, since the disk does not keep up" in recorder.trouble()
    gate.go_on.set()
    recorder.close()
    assert len(gate.written) == 100
    assert gate.is_closed


def test_a_disk_that_stands_still_ends_the_recording_and_not_the_run(monkeypatch):
    monkeypatch.setattr(recorder_module, "WAITING_MAX", 50)
    gate = Gate()
    recorder = Recorder(gate, is_live=True)
    for _ in range(100):
        recorder(RECORD, FRAME)
    assert "the disk does not keep up: 50 cycles wait for it; the recording ends here" in recorder.trouble()
    gate.go_on.set()
    recorder.close()


@pytest.mark.parametrize("is_live", [True, False])
@pytest.mark.parametrize("failure", [JournalError("run.mcap: the disk is full"), ZeroDivisionError("a mistake")])
def test_a_recording_that_fails_never_stops_the_run(is_live, failure):
    gate = Gate(failure)
    gate.go_on.set()
    recorder = Recorder(gate, is_live=is_live)
    for _ in range(200):
        recorder(RECORD, FRAME)
    recorder.close()
    assert str(failure) in recorder.failure
    assert gate.is_abandoned


@pytest.mark.parametrize("is_live", [True, False])
def test_a_run_that_was_asked_to_end_does_not_wait_for_a_disk_that_hangs(is_live, monkeypatch):
    monkeypatch.setattr(recorder_module, "END_WAIT_S", math.inf)
    monkeypatch.setattr(recorder_module, "GOODBYE_S", 0.0)
    gate, deadline = Gate(), Deadline()
    deadline.set()
    recorder = Recorder(gate, is_live=is_live, deadline=deadline)
    for _ in range(20):
        recorder(RECORD, FRAME)
    recorder.close()
    assert "the disk does not answer; the end of the recording is missing" in recorder.failure
    gate.go_on.set()


def test_what_waits_is_written_before_the_end():
    gate = Gate()
    gate.go_on.set()
    recorder = Recorder(gate, is_live=False)
    for _ in range(5):
        recorder(RECORD, FRAME)
    recorder.note_reload(1.0, RecordedConfiguration(text="# another"))
    recorder(RECORD, None)
    recorder.close()
    recorder.close()
    assert gate.written == [(RECORD, FRAME)] * 5 + [RecordedConfiguration(text="# another"), (RECORD, None)]
    assert recorder.trouble() == ""
