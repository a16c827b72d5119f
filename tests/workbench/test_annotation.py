"""Measuring pictures, and what is drawn in their copies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.loader import DriverChoice
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.errors import PictureError
from stadimeter.workbench import annotation
from stadimeter.workbench.annotation import GREEN, GREY, Box, Mark, annotate, write_picture
from stadimeter.workbench.measuring import Measuring
from support.crossing_balls import BLANK, PretendBalls

pytestmark = pytest.mark.vision


# Annotated copies.

CORNERS = np.array([(200.0, 100.0), (500.0, 120.0), (490.0, 330.0), (190.0, 300.0)])


def _blank(width: int = 900, height: int = 600) -> np.ndarray:
    return np.full((height, width, 3), 128, np.uint8)


def _mark(status: DetectionStatus = DetectionStatus.FOUND, outline: np.ndarray = CORNERS, **changes: object) -> Mark:
    detection = Detection(
        target="paper", status=status, outline_px=outline, centre_px=(345.0, 212.0), width_px=300.0, height_px=205.0
    )
    return Mark(
        detection=detection,
        has_corners=len(outline) == 4,
        **{"headline": "35.0 in ± 0.4", "lines": ("paper: 35.0 in ± 0.4",), **changes},
    )


def _pixels_of(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    rows, columns = np.nonzero(np.abs(image.astype(int) - colour).max(axis=2) < 12)
    return np.column_stack([columns, rows])


def test_the_limb_of_a_ball_is_drawn_where_it_was_seen_and_open_where_it_was_not() -> None:
    angles = np.linspace(0, 1.3 * np.pi, 80)
    limb = np.column_stack([345 + 100 * np.cos(angles), 212 + 100 * np.sin(angles)])
    mark = _mark(outline=limb, headline="x", lines=())
    green = _pixels_of(annotate(_blank(), [mark]), GREEN)
    assert np.hypot(*(green - (345, 312)).T).min() < 2
    assert np.hypot(*(green - (345, 112)).T).min() > 20


def _places(marks: list[Mark], width: int, height: int) -> tuple[list[Box], list[Box]]:
    """Return where the labels and the panels of a picture are drawn."""
    words = [*annotation.place_words(_blank(width, height), marks, 1, max(width, height) / annotation.REFERENCE_PX)]
    return [box for mark, _, box in words if mark is not None], [box for mark, _, box in words if mark is None]


def _meet(one: Box, other: Box) -> bool:
    return one.left < other.right and other.left < one.right and one.top < other.bottom and other.top < one.bottom


LINES = ("ball: 1.234 m ± 0.005", "depth 1.234 m ± 0.005, 14.0 deg right, 27.4 deg down", "223.4 x 223.4 px ± 1.30")


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    size=st.tuples(st.integers(600, 2400), st.integers(600, 2400)),
    middle=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    share=st.floats(0.02, 0.3),
    name=st.text(st.characters(codec="ascii", categories=("L", "N")), min_size=1, max_size=24),
)
def test_neither_label_nor_legend_of_one_target_covers_it_or_the_other(
    size: tuple[int, int], middle: tuple[float, float], share: float, name: str
) -> None:
    radius = share * min(size)
    angles = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    limb = np.array(middle) * size + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    mark = _mark(outline=limb, headline=f"{name}: 1.234 m ± 0.005", lines=LINES)
    labels, panels = _places([mark], *size)
    assert (len(labels), len(panels)) == (1, 1)
    assert not _meet(labels[0], panels[0])
    for box in (*labels, *panels):
        assert box.left >= 0
        assert box.top >= 0
        assert box.right <= size[0]
        assert box.bottom <= size[1]
        nearest = np.clip(limb.mean(axis=0), (box.left, box.top), (box.right, box.bottom))
        assert math.dist(nearest, limb.mean(axis=0)) > radius


def test_what_was_rejected_is_drawn_as_a_thin_ring_with_its_number() -> None:
    candidate = RejectedCandidate(centre_px=(700.0, 450.0), size_px=120.0, reason="support 0.31, limit 0.60")
    plain = annotate(_blank(), [_mark()])
    copy = annotate(_blank(), [_mark(rejected=((7, candidate),))])
    away = np.argwhere((copy != plain).any(axis=2))[:, ::-1] - (700, 450)
    far = np.hypot(*away.T)
    assert 55 < far.min() < 60, "inside the ring the picture stays as it is"
    on_ring = away[np.abs(far - 60) < 2]
    assert len(np.unique(np.round(np.degrees(np.arctan2(on_ring[:, 1], on_ring[:, 0])) / 5))) >= 72, "all around"
    assert (far > 70).sum() > 100, "the number beside it"
    assert len(_pixels_of(copy, GREY)) > 50


def test_the_words_of_many_targets_cover_neither_a_target_nor_each_other() -> None:
    squares = np.array([(0.0, 0.0), (90.0, 0.0), (90.0, 90.0), (0.0, 90.0)])
    marks = [
        _mark(outline=np.add(squares, (60 + 210 * column, 40 + 190 * row))) for row in range(3) for column in range(4)
    ]
    labels, panels = _places(marks, 900, 600)
    assert len(labels) == len(marks)
    boxes = [*labels, *panels, *(annotation._box_around(mark.detection.outline_px) for mark in marks)]
    assert not [(one, other) for at, one in enumerate(boxes) for other in boxes[:at] if one.meets(other)]


def test_whatever_was_rejected_the_copy_is_drawn() -> None:
    for candidate in [
        ((math.nan, 5.0), 10.0),
        ((5.0, 5.0), math.inf),
        ((1e12, 5.0), 10.0),
        ((5.0, 5.0), 0.0),
        ((-30.0, 900.0), 4000.0),
    ]:
        centre_px, size_px = candidate
        rejected = RejectedCandidate(centre_px=centre_px, size_px=size_px, reason="x")
        assert annotate(_blank(), [_mark(rejected=((1, rejected),))]).shape == (600, 900, 3)


def test_a_copy_that_cannot_be_written_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="cannot be written: no such file or directory"):
        write_picture(tmp_path / "missing" / "a.png", _blank())
    with pytest.raises(PictureError, match=r"end in '\.nonsense'"):
        write_picture(tmp_path / "a.nonsense", _blank())
    assert list(tmp_path.iterdir()) == []


def test_where_a_target_fills_the_picture_its_figures_stand_alone_and_cover_no_label(monkeypatch) -> None:
    boxes: list[Box] = []
    draw = annotation.Panel.draw
    monkeypatch.setattr(annotation.Panel, "draw", lambda panel, box: (boxes.append(box), draw(panel, box)))
    corners = np.array([(20.0, 60.0), (880.0, 60.0), (880.0, 590.0), (20.0, 590.0)])
    lines = ("paper: 35.0 in ± 0.4 and so on and so on",) * 3
    annotate(_blank(), [_mark(outline=corners, headline="paper: 35.0 in ± 0.4", lines=lines)])
    assert len(boxes) == 1
    boxes.clear()
    annotate(_blank(), [_mark()])
    assert len(boxes) == 2
    assert not boxes[0].meets(boxes[1])


# Measuring picture files.

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


@pytest.fixture
def targets() -> tuple[NamedDetector, ...]:
    model = load_driver(DETECTORS, "ball")
    options = model.model_validate({"diameter": "10 cm", "hsv": "170,100,60:10,255,255"})
    choices = [DriverChoice(name=name, driver="ball", options=options) for name in ("left", "right")]
    return build_detectors(choices, CAMERA)


@pytest.fixture
def ball_picture(tmp_path: Path) -> Path:
    image = np.full((480, 640, 3), (120, 110, 100), np.uint8)
    cv2.circle(image, (320, 240), 30, (40, 30, 200), -1, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "ball.png"), image)
    return tmp_path / "ball.png"


def test_a_picture_of_another_size_is_measured_through_the_scaled_camera(ball_picture: Path, targets) -> None:
    large = ball_picture.with_name("large.png")
    cv2.imwrite(str(large), cv2.resize(cv2.imread(str(ball_picture)), (1280, 960), interpolation=cv2.INTER_CUBIC))
    small_m = Measuring(targets, CAMERA).measure_file(ball_picture).targets[0].measurement.distance_m
    assert Measuring(targets, CAMERA).measure_file(large).targets[0].measurement.distance_m == pytest.approx(
        small_m, rel=0.01
    )


class Steady(PretendBalls):
    """Finds every ball in every frame."""

    def _is_found(self, seen: object) -> bool:
        return True


class Film:
    """A source of blank frames, thirty a second."""

    def frames(self, note: object) -> Iterator[Frame]:
        for number in range(60):
            yield Frame(BLANK, number / 30, number)


def test_several_of_one_kind_keep_their_names_through_a_video() -> None:
    """The left one goes away and the right one comes nearer, which makes it the largest."""
    far_m = np.linspace(1.0, 1.6, 60)
    left, right = (
        np.stack([0 * far_m + x_m, 0 * far_m, z_m], axis=1) for x_m, z_m in ((-0.2, far_m), (0.2, far_m[::-1]))
    )
    balls = Steady(np.stack([left, right], axis=1), seed=1)
    target = NamedDetector(name="balls", detector=balls, members=("balls-1", "balls-2"))
    named = [
        {each.measurement.target: (each.measurement.position_m or (0.0,))[0] > 0 for each in result.targets}
        for result in Measuring([target], CAMERA).measure_all(Film(), "film.mp4", print)
    ]
    assert len(named) == 60
    assert all(each == named[0] for each in named)
    assert set(named[0]) == {"balls-1", "balls-2"}
