"""The detector contract catches mistakes: each wrong detector fails the test that is named beside it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector
from stadimeter.ranging.ball import BallShape
from stadimeter.testing.detector_contract import DetectorContract, DetectorRig
from support.detector_rigs import detector_rig
from support.each_case import each_case

Lens = CameraModel | None

pytestmark = pytest.mark.vision


def scaled(found: Detection, factor: float) -> Detection:
    """Return a detection of something larger in the same place."""
    outline_px = found.centre_px + factor * (found.outline_px - found.centre_px)
    return replace(found, outline_px=outline_px, width_px=factor * found.width_px, height_px=factor * found.height_px)


@dataclass
class Wrong:
    """A detector that is right, until a subclass is not."""

    right: Detector
    target_shape: BallShape = field(init=False)
    seen: list[Detection] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.target_shape = self.right.target_shape

    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        return self.changed(self.right.detect(frame, prediction, lens=lens))

    def changed(self, found: Detection) -> Detection:
        return found


class TooLarge(Wrong):
    def changed(self, found: Detection) -> Detection:
        return scaled(found, 1.05)


class ShiftedByHalfItsSize(Wrong):
    def changed(self, found: Detection) -> Detection:
        shift = np.array((found.width_px / 2, 0.0))
        x, y = found.centre_px + shift
        return replace(found, outline_px=found.outline_px + shift, centre_px=(x, y))


class FailsOnNothing(Wrong):
    def changed(self, found: Detection) -> Detection:
        if found.status is DetectionStatus.NOT_FOUND:
            raise IndexError("list index out of range")
        return found


class MeasuresWhatIsCutOff(Wrong):
    def changed(self, found: Detection) -> Detection:
        return replace(found, status=DetectionStatus.FOUND) if len(found.outline_px) else found


class TakesWhatItFoundLast(Wrong):
    def changed(self, found: Detection) -> Detection:
        if found.status is DetectionStatus.FOUND:
            self.seen[:] = [found]
        return self.seen[0] if self.seen else found


class LooksOnlyWhereExpected(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        found = self.right.detect(frame, prediction, lens=lens)
        if prediction is None or np.hypot(*np.subtract(found.centre_px, prediction.centre_px)) < prediction.size_px:
            return found
        return Detection(target="it", status=DetectionStatus.NOT_FOUND, reason="not where it was expected")


class IgnoresPredictions(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        return self.right.detect(frame, lens=lens)


class KnowsOneResolution(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        return scaled(self.right.detect(frame, prediction, lens=lens), 640 / frame.width_px)


class Draws(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        found = self.right.detect(frame, prediction, lens=lens)
        frame.image[:3] = 255
        return found


class Random(Wrong):
    def changed(self, found: Detection) -> Detection:
        return replace(found, quality=float(np.random.default_rng().uniform()))


class NeedsWholeRows(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        flat = frame.image if frame.image.flags.c_contiguous else np.zeros(frame.image.shape, np.uint8)
        return self.right.detect(replace(frame, image=flat), prediction, lens=lens)


class TakesAnyImage(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        try:
            return self.right.detect(frame, prediction, lens=lens)
        except ValueError:
            return Detection(target="it", status=DetectionStatus.NOT_FOUND, reason="no such colour")


class FailsOnTinyImages(Wrong):
    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: Lens = None) -> Detection:
        if min(frame.image.shape[:2]) < 2:
            raise ZeroDivisionError
        return self.right.detect(frame, prediction, lens=lens)


MISTAKES: dict[type[Wrong], str] = {
    TooLarge: "test_the_target_is_found_at_its_distance",
    ShiftedByHalfItsSize: "test_a_detection_is_complete",
    FailsOnNothing: "test_a_frame_without_the_target_is_no_error_and_has_a_reason",
    MeasuresWhatIsCutOff: "test_a_target_that_the_border_cuts_off_is_reported_and_not_measured",
    TakesWhatItFoundLast: "test_no_frame_changes_the_answer_to_another",
    LooksOnlyWhereExpected: "test_a_wrong_prediction_hides_nothing",
    IgnoresPredictions: "test_of_two_targets_alike_the_expected_one_is_taken",
    KnowsOneResolution: "test_a_frame_of_half_the_resolution_gives_the_same_distance",
    Draws: "test_the_image_is_not_changed",
    Random: "test_the_same_frame_gives_the_same_answer",
    NeedsWholeRows: "test_an_image_that_is_part_of_a_larger_one_gives_the_same_answer",
    TakesAnyImage: "test_an_image_of_another_form_is_refused",
    FailsOnTinyImages: "test_in_a_tiny_image_nothing_is_found",
}


def run(test: str, make_rig: Callable[[], DetectorRig]) -> None:
    """Run a test of the suite with all its parameters, as pytest does."""
    suite = DetectorContract()
    method = getattr(suite, test)
    wanted = inspect.signature(method).parameters
    fixed = {"make_rig": make_rig, "rig": make_rig()}
    given = {name: value for name, value in fixed.items() if name in wanted}
    marks = [mark for mark in getattr(method, "pytestmark", ()) if mark.name == "parametrize"]
    for value in marks[0].args[1] if marks else ((),):
        method(**given, **({marks[0].args[0]: value} if marks else {}))


@each_case("wrong", MISTAKES)
def test_a_wrong_detector_fails_the_test_for_its_mistake(wrong: type[Wrong]) -> None:
    def make_rig() -> DetectorRig:
        rig = detector_rig("ball")
        return replace(rig, detector=wrong(rig.detector))

    with pytest.raises((AssertionError, pytest.fail.Exception, IndexError, ArithmeticError, ValueError)):
        run(MISTAKES[wrong], make_rig)


@each_case("test", sorted(set(MISTAKES.values())))
def test_a_right_detector_passes_the_same_tests(test: str) -> None:
    run(test, lambda: replace(detector_rig("ball"), detector=Wrong(detector_rig("ball").detector)))
