"""The sides of outlines, on drawn pictures whose truth is exact."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.plugins import DriverContext
from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import ShowsEdges
from stadimeter.detectors.sampling import light_table
from stadimeter.detectors.sheet.edges import SUPPORTED, OutlineSides, SheetPicture, measure_cut_off, refine_corners
from stadimeter.detectors.sheet.evidence import find_quadrilaterals
from stadimeter.testing.rig import ManualClock
from support.detector_rigs import CAMERA, LEFT, SCENES, WALL, build
from support.scenes.draw import sheet_scene
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

LIGHT = light_table("srgb")
MADE = render(sheet_scene(4, 0.4, plain=True))
SEEN = SheetPicture(MADE.image, LIGHT, None)
CORNERS = MADE.truth.outline_px


def measured(corners_px: np.ndarray, sigma_px: float, picture: SheetPicture = SEEN) -> OutlineSides:
    """Return the sides about there, which must be there."""
    sides = refine_corners(picture, corners_px, sigma_px)
    assert sides is not None
    return sides


def test_of_a_sheet_that_the_border_cuts_the_free_side_stays_where_it_is() -> None:
    cut = int(CORNERS[:, 0].mean())
    corners = CORNERS.copy()
    for near, far in ((1, 0), (2, 3)):  # the right side is where the border cuts
        share = (cut - 1 - CORNERS[far, 0]) / (CORNERS[near, 0] - CORNERS[far, 0])
        corners[near] = CORNERS[far] + share * (CORNERS[near] - CORNERS[far])
    free = np.array((False, True, False, False))
    sides = measure_cut_off(SheetPicture(MADE.image[:, :cut].copy(), LIGHT, None), corners + 0.5, 6.0, free)
    assert sides is not None
    assert sides.support[~free].min() > 0.9
    assert np.abs(sides.corners_px[[0, 3]] - CORNERS[[0, 3]]).max() < 0.2
    assert np.abs(sides.corners_px[[1, 2], 0] - corners[[1, 2], 0]).max() < 1.5


def test_something_that_touches_the_sheet_does_not_hide_its_outline() -> None:
    mask = np.zeros((200, 300), np.uint8)
    mask[50:150, 80:220] = 255
    mask[100:110, 220:280] = 255
    mask[20:50, 120:130] = 255
    outlines = find_quadrilaterals([mask], 10.0)
    wanted = np.array(((80, 50), (219, 50), (219, 149), (80, 149)))
    assert np.abs(outlines - wanted).max(axis=(1, 2)).min() < 2


def test_a_side_half_hidden_is_measured_by_what_is_seen_of_it() -> None:
    middle = CORNERS[:2].mean(axis=0)
    left, right = np.add(middle, (-17, -12)), np.add(middle, (17, -12))
    finger = np.array((left, right, CORNERS.mean(axis=0)))
    image = np.asarray(cv2.fillPoly(MADE.image.copy(), [np.rint(finger).astype(np.int32)], (20, 60, 200)))
    hidden = SheetPicture(image, LIGHT, None)
    sides = measured(CORNERS, 1.0, hidden)
    assert np.abs(sides.corners_px - CORNERS).max() < 0.2
    assert sides.support.min() < SUPPORTED


def test_a_sheet_with_a_corner_beyond_the_border_is_measured_by_the_rest() -> None:
    cut = int(CORNERS[:, 0].max() - 0.2 * np.ptp(CORNERS[:, 0]))
    sides = measured(CORNERS, 2.0, SheetPicture(MADE.image[:, :cut].copy(), LIGHT, None))
    seen = CORNERS[:, 0] < cut
    assert np.abs(sides.corners_px[seen] - CORNERS[seen]).max() < 0.3


# Edge points that detectors show lie on the outline of the target.


BENT = replace(CAMERA, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0))


def off_px(points: Points, outline: Points) -> np.ndarray:
    """Return how far each point is from a closed line."""
    starts, along = outline, np.roll(outline, -1, axis=0) - outline
    rest = points[:, np.newaxis] - starts
    share = np.clip((rest * along).sum(axis=2) / (along * along).sum(axis=1), 0, 1)
    return np.hypot(*np.moveaxis(rest - share[..., np.newaxis] * along, 2, 0)).min(axis=1)


@pytest.mark.parametrize("driver", ["ball", "sheet", "tag"])
def test_the_points_lie_on_the_true_outline(driver: str) -> None:
    options, place, _ = SCENES[driver]
    scene = render(Scene(camera=CAMERA, target=place(LEFT), seed=1, backdrop=WALL))
    detector = build(driver, options, DriverContext(name=driver, clock=ManualClock()))
    frame = Frame(image=scene.image, captured_at_s=0.0, sequence=0)
    found = detector.detect(frame, lens=CAMERA)
    assert isinstance(detector, ShowsEdges)
    points = detector.edge_points(frame, found, lens=CAMERA)
    off = off_px(points, scene.truth.outline_px)
    assert len(points) > 20
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.95) < 0.3


@pytest.mark.parametrize("driver", ["sheet", "tag"])
def test_through_a_lens_that_bends_the_points_follow_the_bent_sides(driver: str) -> None:
    options, place, _ = SCENES[driver]
    target = place(LEFT)
    scene = render(Scene(camera=BENT, target=target, seed=1, backdrop=WALL))
    detector = build(driver, options, DriverContext(name=driver, clock=ManualClock()))
    frame = Frame(image=scene.image, captured_at_s=0.0, sequence=0)
    points = detector.edge_points(frame, detector.detect(frame, lens=BENT), lens=BENT)
    corners = target.outline_m()
    share = np.linspace(0, 1, 40, endpoint=False)[:, np.newaxis, np.newaxis]
    sides = (corners + share * (np.roll(corners, -1, axis=0) - corners)).transpose(1, 0, 2).reshape(-1, 3)
    off = off_px(points, BENT.project(sides[:, :2] / sides[:, 2:]))
    assert len(points) > 20
    assert np.median(off) < 0.1
