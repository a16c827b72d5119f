"""The detector contract over every registered detector, and wrong detectors, each of which fails the test beside it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.plugins import DETECTORS, driver_names
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.testing.detector_contract import DetectorContract, DetectorRig
from support.detector_rigs import detector_rig
from support.each_case import each_case

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]


class TestEveryDetector(DetectorContract):
    @pytest.fixture(params=sorted(driver_names(DETECTORS)))
    def make_rig(self, request: pytest.FixtureRequest) -> Callable[[], DetectorRig]:
        return partial(detector_rig, request.param)


# Each is given what finds the target as it should, the frame and the prediction.


def scaled(found: Detection, factor: float) -> Detection:
    """Return a detection of something larger in the same place."""
    outline_px = found.centre_px + factor * (found.outline_px - found.centre_px)
    return replace(found, outline_px=outline_px, width_px=factor * found.width_px, height_px=factor * found.height_px)


def shift_by_half_its_size(right: Any, frame: Any, prediction: Any) -> Detection:
    found = right(frame, prediction)
    shift = np.array((found.width_px / 2, 0.0))
    x, y = found.centre_px + shift
    return replace(found, outline_px=found.outline_px + shift, centre_px=(x, y))


def fail_on_nothing(right: Any, frame: Any, prediction: Any) -> Detection:
    if (found := right(frame, prediction)).status is DetectionStatus.NOT_FOUND:
        raise IndexError("list index out of range")
    return found


def measure_what_is_cut_off(right: Any, frame: Any, prediction: Any) -> Detection:
    found = right(frame, prediction)
    return replace(found, status=DetectionStatus.FOUND) if len(found.outline_px) else found


def take_what_was_found_last(right: Any, frame: Any, prediction: Any) -> Detection:
    found = right(frame, prediction)
    right.last = found if found.status is DetectionStatus.FOUND else getattr(right, "last", found)
    return right.last


def look_only_where_expected(right: Any, frame: Any, prediction: Any) -> Detection:
    found = right(frame, prediction)
    if prediction is None or np.hypot(*np.subtract(found.centre_px, prediction.centre_px)) < prediction.size_px:
        return found
    return Detection(target="it", status=DetectionStatus.NOT_FOUND, reason="not where it was expected")


def draw_into_the_image(right: Any, frame: Any, prediction: Any) -> Detection:
    found = right(frame, prediction)
    frame.image[:3] = 255
    return found


def need_whole_rows(right: Any, frame: Any, prediction: Any) -> Detection:
    flat = frame.image if frame.image.flags.c_contiguous else np.zeros(frame.image.shape, np.uint8)
    return right(replace(frame, image=flat), prediction)


MISTAKES: list[tuple[str, Callable[..., Detection]]] = [
    ("test_the_target_is_found_at_its_distance", lambda right, *given: scaled(right(*given), 1.05)),
    ("test_a_detection_is_complete", shift_by_half_its_size),
    ("test_a_frame_without_the_target_is_no_error_and_has_a_reason", fail_on_nothing),
    ("test_a_target_that_the_border_cuts_off_is_reported_and_not_measured", measure_what_is_cut_off),
    ("test_the_same_frame_gives_the_same_answer", take_what_was_found_last),
    ("test_a_wrong_prediction_hides_nothing", look_only_where_expected),
    ("test_of_two_targets_alike_the_expected_one_is_taken", lambda right, frame, _: right(frame, None)),
    (
        "test_a_frame_of_half_the_resolution_gives_the_same_distance",
        lambda right, frame, prediction: scaled(right(frame, prediction), 640 / frame.width_px),
    ),
    ("test_the_same_frame_gives_the_same_answer", draw_into_the_image),
    (
        "test_the_same_frame_gives_the_same_answer",
        lambda right, *given: replace(right(*given), quality=float(np.random.default_rng().uniform())),
    ),
    ("test_an_image_that_is_part_of_a_larger_one_gives_the_same_answer", need_whole_rows),
]


class Planted:
    """A detector that answers wrongly; called, it gives the right answer."""

    def __init__(self, rig: DetectorRig, wrong: Callable[..., Detection]) -> None:
        self.target_shape = rig.detector.target_shape
        self._detector, self._wrong, self._lens = rig.detector, wrong, None

    def __call__(self, frame: Any, prediction: Any) -> Detection:
        return self._detector.detect(frame, prediction, lens=self._lens)

    def detect(self, frame: Any, prediction: Any = None, *, lens: Any = None) -> Detection:
        self._lens = lens
        return self._wrong(self, frame, prediction)


def run(test: str, wrong: Callable[..., Detection]) -> None:
    """Run a test of the suite with all its parameters, as pytest does."""

    def make_rig() -> DetectorRig:
        rig = detector_rig("ball")
        return replace(rig, detector=Planted(rig, wrong))

    method = getattr(DetectorContract(), test)
    fixed = {"make_rig": make_rig, "rig": make_rig()}
    given = {name: value for name, value in fixed.items() if name in inspect.signature(method).parameters}
    marks = [mark for mark in getattr(method, "pytestmark", ()) if mark.name == "parametrize"]
    for value in marks[0].args[1] if marks else ((),):
        method(**given, **({marks[0].args[0]: value} if marks else {}))


@each_case(("test", "wrong"), MISTAKES)
def test_a_wrong_detector_fails_the_test_for_its_mistake(test: str, wrong: Callable[..., Detection]) -> None:
    with pytest.raises((AssertionError, pytest.fail.Exception, IndexError, ArithmeticError, ValueError)):
        run(test, wrong)


@each_case("test", [test for test, _ in MISTAKES])
def test_a_right_detector_passes_the_same_tests(test: str) -> None:
    run(test, lambda right, *given: right(*given))
