"""The contract of every detector. Subclass `DetectorContract` with a fixture ``make_rig``, and pytest runs it all.

::

    class TestMyDetector(DetectorContract):
        @pytest.fixture
        def make_rig(self) -> Callable[[], DetectorRig]:
            return my_rig

The rig holds the frames to look at: rendered ones whose truth is known, or photographs at taped distances.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError
from stadimeter.ranging.measure import measure
from stadimeter.testing.rig import Contract

# So begins the reason of a detector that sees the target more than once and cannot tell which one it is.
AMBIGUOUS = "ambiguous: "

# A distance may be wrong by this many of the standard deviations stated with it.
SIGMAS = 4.0

# A standard deviation above this share of the distance says nothing: no error would be too large for it.
MAX_SIGMA_SHARE = 0.2

PREDICTION_SIGMA_PX = 2.0

WRONG_PREDICTIONS: tuple[dict[str, Any], ...] = (
    *({"centre_px": each} for each in ((2.0, 2.0), (-5000.0, 5000.0), (math.nan, math.nan), (math.inf, 0.0))),
    *({"size_px": each} for each in (0.0, 3.0, 3000.0, math.nan, math.inf)),
    *({"sigma_px": each} for each in (0.0, 5000.0, math.nan, math.inf)),
)


class KnownTarget(Struct, frozen=True, kw_only=True, eq=False):
    """A target whose true distance is known, and where a tracker would expect it."""

    distance_m: float
    centre_px: tuple[float, float]
    size_px: float
    """Its apparent size: of something round the diameter, of something flat the longer side."""

    @property
    def prediction(self) -> Prediction:
        """A prediction that is right."""
        return Prediction(centre_px=self.centre_px, size_px=self.size_px, sigma_px=PREDICTION_SIGMA_PX)


class DetectorRig(Struct, frozen=True, kw_only=True, eq=False):
    """A detector and what to show it. All frames have the same size, with even width and height.

    Attributes:
        detector: A new detector for a target with the name ``it``, built for `camera`.
        camera: The camera model at the frames' resolution.
        whole: A frame with the target whole, not in the centre of the picture.
        target: The target in it.
        empty: A frame without the target.
        cut_off: A frame whose border cuts the target off, far enough inside to be recognised.
        two: A frame with two targets alike, both whole; None for a detector that only knows of one.
        both: The targets in that.
        takes_nearest: Whether of several the nearest counts, whichever was expected.
    """

    detector: Detector
    camera: CameraModel
    whole: Frame
    target: KnownTarget
    empty: Frame
    cut_off: Frame
    two: Frame | None = None
    both: Sequence[KnownTarget] = ()
    takes_nearest: bool = False

    def detect(self, frame: Frame, prediction: Prediction | None = None) -> Detection:
        """Detect as a run does: with the lens at the frame's resolution; without one if the aspect is another."""
        try:
            lens = self.camera.scaled_to(frame.width_px, frame.height_px)
        except CalibrationError:
            lens = None
        return self.detector.detect(frame, prediction, lens=lens)

    def measured(self, detection: Detection, frame: Frame) -> Measurement:
        """Measure what was detected, as a run does."""
        lens = self.camera.scaled_to(frame.width_px, frame.height_px)
        return measure(detection, self.detector.target_shape, lens, frame.captured_at_s)

    def check_distance(self, detection: Detection, frame: Frame, *known: KnownTarget) -> None:
        """Fail unless the target was found at one of the known distances, within what is stated of it."""
        assert detection.status is DetectionStatus.FOUND, f"the target is there, but: {detection.reason}"
        measurement = self.measured(detection, frame)
        distance_m, sigma_m = measurement.distance_m, measurement.sigma_m
        assert distance_m is not None, measurement.reason
        assert sigma_m is not None, measurement.reason
        assert 0 < sigma_m < MAX_SIGMA_SHARE * distance_m, f"a standard deviation of {sigma_m} m says nothing"
        off_m = min(abs(distance_m - each.distance_m) for each in known)
        assert off_m <= SIGMAS * sigma_m, f"{distance_m:.4f} m is off by {off_m / sigma_m:.1f} standard deviations"


class DetectorContract(Contract):
    """The tests."""

    def test_the_target_is_found_at_its_distance(self, rig: DetectorRig) -> None:
        """It is right within a few standard deviations, also where it is looked for first: that is a short cut only."""
        for prediction in (None, rig.target.prediction):
            rig.check_distance(rig.detect(rig.whole, prediction), rig.whole, rig.target)

    def test_a_detection_is_complete(self, rig: DetectorRig) -> None:
        """Measuring, tracking and drawing rely on each of its fields."""
        found = rig.detect(rig.whole)
        assert found.target == "it", "a detection has the name of its target"
        outline = found.outline_px
        assert outline.dtype == np.float64
        assert outline.shape == (len(outline), 2), "an outline has the shape (n, 2)"
        assert len(outline) >= 3, "an outline encloses something"
        assert np.isfinite(outline).all()
        centre, low, high = np.array(found.centre_px), outline.min(axis=0), outline.max(axis=0)
        assert ((low < centre) & (centre < high)).all(), "the centre is inside the outline"
        apart_px = np.abs(centre - rig.target.centre_px).max()
        assert apart_px < rig.target.size_px / 4, "the centre is where the target is"
        for name in ("width_px", "height_px", "size_sigma_px"):
            assert 0 < getattr(found, name) < math.inf, f"{name} is a positive number"
        assert 0 <= found.quality <= 1, "quality is from 0 to 1"

    def test_a_frame_without_the_target_is_no_error_and_has_a_reason(self, rig: DetectorRig) -> None:
        """Also where the target is expected: a track does not end at once."""
        for prediction in (None, rig.target.prediction):
            found = rig.detect(rig.empty, prediction)
            assert found.status is DetectionStatus.NOT_FOUND, "there is no target in that frame"
            assert found.target == "it"
            assert not len(found.outline_px), "what was not found has no outline"
            check_reason(found.reason)
            assert rig.measured(found, rig.empty).status is MeasurementStatus.NOT_FOUND

    def test_a_target_that_the_border_cuts_off_is_reported_and_not_measured(self, rig: DetectorRig) -> None:
        """Its apparent size is not known, so any distance would be wrong."""
        for prediction in (None, rig.target.prediction):
            found = rig.detect(rig.cut_off, prediction)
            assert found.status is DetectionStatus.TRUNCATED, f"the border cuts it off: {found.status} {found.reason}"
            check_reason(found.reason)

    def test_of_two_targets_alike_one_is_measured(self, rig: DetectorRig) -> None:
        """It is one of the two, not something between them; or none, if the reason says that this is ambiguous."""
        frame = _two(rig)
        found = rig.detect(frame)
        if found.status is DetectionStatus.NOT_FOUND and found.reason.startswith(AMBIGUOUS):
            return
        rig.check_distance(found, frame, *rig.both)

    @pytest.mark.parametrize("expected", [0, 1], ids=["first", "second"])
    def test_of_two_targets_alike_the_expected_one_is_taken(self, rig: DetectorRig, expected: int) -> None:
        """A track stays with its target while another one is in view, unless that is nearer and the nearest counts."""
        frame, known = _two(rig), rig.both[expected]
        found = rig.detect(frame, known.prediction)
        if rig.takes_nearest:
            known = min(rig.both, key=lambda each: each.distance_m)
        rig.check_distance(found, frame, known)
        apart_px = math.dist(found.centre_px, known.centre_px)
        assert apart_px < known.size_px / 2, f"the other one was taken, {apart_px:.0f} px away"

    def test_a_wrong_prediction_hides_nothing(self, rig: DetectorRig) -> None:
        """A target that is not where it was expected is looked for in the whole frame."""
        for change in WRONG_PREDICTIONS:
            prediction = replace(rig.target.prediction, **change)
            rig.check_distance(rig.detect(rig.whole, prediction), rig.whole, rig.target)

    def test_a_frame_of_half_the_resolution_gives_the_same_distance(self, rig: DetectorRig) -> None:
        """The camera model may be for any resolution of the same aspect."""
        frame = replace(rig.whole, image=_halved(rig.whole.image))
        rig.check_distance(rig.detect(frame), frame, rig.target)

    def test_the_same_frame_gives_the_same_answer(self, make_rig: Callable[[], DetectorRig]) -> None:
        """Again, whatever came before, and from another detector that is built alike: recordings are replayed.

        A detector keeps no state: what is known from before is in the prediction.
        """
        rig, fresh = make_rig(), make_rig()
        for frame in (rig.whole, rig.empty, rig.cut_off, rig.whole):
            before = frame.image.copy()
            rig.detect(frame)
            rig.detect(frame, rig.target.prediction)
            assert np.array_equal(frame.image, before), "the detector wrote into the image, at which others look, too"
        for seen, unseen in ((rig.empty, fresh.empty), (rig.cut_off, fresh.cut_off), (rig.whole, fresh.whole)):
            for prediction in (None, rig.target.prediction):
                assert _same(rig.detect(seen, prediction), fresh.detect(unseen, prediction)), "the answers differ"

    def test_an_image_that_is_part_of_a_larger_one_gives_the_same_answer(self, rig: DetectorRig) -> None:
        """Its rows then do not follow each other in memory."""
        height, width = rig.whole.image.shape[:2]
        larger = np.zeros((height + 6, width + 10, 3), np.uint8)
        part = larger[3:-3, 5:-5]
        part[:] = rig.whole.image
        found = rig.detect(replace(rig.whole, image=part))
        assert _same(found, rig.detect(rig.whole))


def check_reason(reason: str) -> None:
    """Fail unless a reason or message is one line with something in it."""
    assert reason.strip(), "the reason is missing"
    assert "\n" not in reason.strip(), "the reason is more than one line"


def _two(rig: DetectorRig) -> Frame:
    if rig.two is None:
        pytest.skip("this detector only knows of one target")
    return rig.two


def _same(one: Detection, other: Detection) -> bool:
    """Compare two detections, to the last bit."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in Detection.__struct_fields__)


def _halved(image: Image) -> Image:
    """Return an image at half the resolution: means of four pixels, as `CameraModel.scaled_to` has it."""
    height, width = image.shape[:2]
    cells = image.reshape(height // 2, 2, width // 2, 2, 3)
    return np.asarray(np.rint(cells.mean(axis=(1, 3))), np.uint8)
