"""One turn of the loop: what detectors are told, and what of their answers others are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector
from stadimeter.ranging.ball import BallShape
from support.simulated_run import SIMULATED_BALL

STILL = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""


class Listening:
    """Passes everything on to a detector, and remembers what was expected."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.target_shape = detector.target_shape
        self.asked: list[tuple[float, Prediction | None, Detection]] = []

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        found = self._detector.detect(frame, prediction, lens=lens)
        self.asked.append((frame.captured_at_s, prediction, found))
        return found


class Blind:
    """Finds nothing, and says what it looked at."""

    target_shape = BallShape(diameter_m=0.2)
    looked_at = RejectedCandidate(centre_px=(30.0, 20.0), size_px=24.0, reason="support 0.31, limit 0.60")

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        assert prediction is None, "a target that was never seen is not expected anywhere"
        return Detection(target="ball", status=DetectionStatus.NOT_FOUND, reason="no ball", rejected=(self.looked_at,))


@pytest.fixture
def loop(tmp_path: Path) -> Loop:
    (tmp_path / "run.toml").write_text(SIMULATED_BALL + STILL, encoding="utf-8")
    return Loop(build(load_configuration(tmp_path / "run.toml"), speed=None))


def listening(loop: Loop) -> Listening:
    detector = Listening(loop.parts.cycle.detectors["ball"])
    loop.parts.cycle.perceiver.detectors = {"ball": detector}
    return detector


def test_a_tracked_target_is_expected_where_it_then_is(loop):
    detector = listening(loop)
    loop.run(Limits(seconds=3))
    told = [(expected, found) for _, expected, found in detector.asked if expected is not None]
    assert len(told) > 0.8 * len(detector.asked)
    for expected, found in told:
        assert np.hypot(*np.subtract(expected.centre_px, found.centre_px)) < 3 * expected.sigma_px
        assert abs(expected.size_px - found.width_px) < 3 * expected.sigma_px


def test_about_once_a_second_the_whole_frame_is_searched(loop):
    detector = listening(loop)
    loop.run(Limits(seconds=5))
    searched_s = [at_s for at_s, expected, _ in detector.asked if expected is None and at_s > 0.5]
    assert 3 <= len(searched_s) <= 5


def test_expecting_changes_no_decision_where_the_detector_finds_the_same(tmp_path, loop):
    other = Loop(build(load_configuration(tmp_path / "run.toml"), speed=None))
    other.parts.cycle.perceiver.expectations.of = lambda *_: None  # type: ignore[method-assign]
    decisions = [recorded(each) for each in (loop, other)]
    assert decisions[0] == decisions[1]


def recorded(loop: Loop) -> list[object]:
    records: list[CycleRecord] = []
    loop.listeners.append(lambda record, _frame: records.append(record))
    loop.run(Limits(seconds=2))
    return [record.decision for record in records]


def test_what_was_rejected_is_told_with_the_cycle(loop):
    loop.parts.cycle.perceiver.detectors = {"ball": Blind()}
    records: list[CycleRecord] = []
    loop.listeners.append(lambda record, _frame: records.append(record))
    loop.run(Limits(frames=5))
    assert records[-1].rejected == {"ball": (Blind.looked_at,)}
    assert records[-1].observation.measurements[0].reason == "no ball"
