"""Edge points that detectors show lie on the outline of the target."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.plugins import DriverContext
from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import ShowsEdges
from stadimeter.testing.rig import ManualClock
from support.detector_rigs import CAMERA, LEFT, SCENES, WALL, build
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

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
