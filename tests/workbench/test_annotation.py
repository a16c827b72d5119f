"""Annotated copies."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.errors import PictureError
from stadimeter.workbench.annotation import GREEN, GREY, ORANGE, RED, Mark, annotate, write_picture

pytestmark = pytest.mark.vision

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


def test_the_picture_itself_is_not_changed_and_the_copy_is() -> None:
    image = _blank()
    copy = annotate(image, [_mark()])
    assert (image == 128).all()
    assert copy.shape == image.shape
    assert (copy != image).any()


def test_the_outline_runs_through_the_corners() -> None:
    green = _pixels_of(annotate(_blank(), [_mark(lines=(), headline="x")]), GREEN)
    for corner in CORNERS:
        assert np.hypot(*(green - corner).T).min() < 2


def test_the_limb_of_a_ball_is_drawn_where_it_was_seen_and_open_where_it_was_not() -> None:
    angles = np.linspace(0, 1.3 * np.pi, 80)
    limb = np.column_stack([345 + 100 * np.cos(angles), 212 + 100 * np.sin(angles)])
    mark = _mark(outline=limb, headline="x", lines=())
    green = _pixels_of(annotate(_blank(), [mark]), GREEN)
    assert np.hypot(*(green - (345, 312)).T).min() < 2
    assert np.hypot(*(green - (345, 112)).T).min() > 20


@pytest.mark.parametrize(("status", "colour"), [(DetectionStatus.FOUND, GREEN), (DetectionStatus.TRUNCATED, ORANGE)])
def test_the_colour_says_what_became_of_it(status: DetectionStatus, colour: tuple[int, int, int]) -> None:
    assert len(_pixels_of(annotate(_blank(), [_mark(status)]), colour)) > 500


def test_a_target_that_was_not_found_stands_in_the_legend_only() -> None:
    mark = _mark(DetectionStatus.NOT_FOUND, outline=np.empty((0, 2)), lines=("paper: not found", "no contour"))
    copy = annotate(_blank(), [mark])
    red = _pixels_of(copy, RED)
    assert len(red) > 10
    assert red[:, 0].max() < 100
    assert red[:, 1].min() > 450
    assert (copy[:450] == 128).all()


def test_the_legend_makes_way_for_a_target_in_its_corner() -> None:
    low = CORNERS + np.array([-150, 250])
    plain = annotate(_blank(), [_mark(outline=low, headline="x", lines=())])
    copy = annotate(_blank(), [_mark(outline=low, headline="x", lines=("one", "two"))])
    changed_rows = np.nonzero((copy != plain).any(axis=(1, 2)))[0]
    assert changed_rows.max() < 200


@pytest.mark.parametrize("size", [(1, 1), (40, 30), (120, 500), (640, 480), (3000, 2000)])
def test_any_size_of_picture_is_drawn_into(size: tuple[int, int]) -> None:
    width, height = size
    scale = np.array(size) / (900, 600)
    detection = Detection(
        target="paper", status=DetectionStatus.FOUND, outline_px=CORNERS * scale, centre_px=(width / 2, height / 2)
    )
    mark = Mark(
        detection=detection,
        has_corners=True,
        headline="35.0 in ± 0.4",
        lines=("paper: a rather long line of text", "± 2"),
    )
    copy = annotate(_blank(width, height), [mark])
    assert max(copy.shape[:2]) >= 600
    assert copy.shape[0] * width == copy.shape[1] * height


def test_what_was_rejected_is_drawn_as_a_thin_ring_with_its_number() -> None:
    candidate = RejectedCandidate(centre_px=(700.0, 450.0), size_px=120.0, reason="support 0.31, limit 0.60")
    plain = annotate(_blank(), [_mark()])
    copy = annotate(_blank(), [_mark(rejected=((7, candidate),))])
    away = np.argwhere((copy != plain).any(axis=2))[:, ::-1] - (700, 450)
    far = np.hypot(*away.T)
    assert 55 < far.min() < 60, "inside the ring the picture stays as it is"
    on_ring = away[np.abs(far - 60) < 2]
    assert len(np.unique(np.round(np.degrees(np.arctan2(on_ring[:, 1], on_ring[:, 0])) / 5))) >= 72, "all around"
    assert ((far > 70) & (away[:, 0] > 0) & (away[:, 1] < 0)).sum() > 100, "the number, at the upper right"
    assert len(_pixels_of(copy, GREY)) > 50


@pytest.mark.parametrize(
    "candidate",
    [((math.nan, 5.0), 10.0), ((5.0, 5.0), math.inf), ((1e12, 5.0), 10.0), ((5.0, 5.0), 0.0), ((-30.0, 900.0), 4000.0)],
    ids=str,
)
def test_whatever_was_rejected_the_copy_is_drawn(candidate: tuple[tuple[float, float], float]) -> None:
    centre_px, size_px = candidate
    rejected = RejectedCandidate(centre_px=centre_px, size_px=size_px, reason="x")
    assert annotate(_blank(), [_mark(rejected=((1, rejected),))]).shape == (600, 900, 3)


def test_the_plus_minus_sign_is_drawn_with_every_font() -> None:
    plain = annotate(_blank(), [_mark(headline="35 +", lines=())])
    signed = annotate(_blank(), [_mark(headline="35 ±", lines=())])
    assert (plain != signed).any()


def test_a_copy_is_written_and_read_back(tmp_path: Path) -> None:
    for suffix in (".png", ".jpg", ".JPG", ".bmp"):
        write_picture(tmp_path / f"a{suffix}", _blank())
        assert cv2.imread(str(tmp_path / f"a{suffix}")).shape == (600, 900, 3)


def test_a_copy_that_cannot_be_written_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="cannot be written: no such file or directory"):
        write_picture(tmp_path / "missing" / "a.png", _blank())
    with pytest.raises(PictureError, match=r"end in '\.nonsense'"):
        write_picture(tmp_path / "a.nonsense", _blank())
    assert list(tmp_path.iterdir()) == []
