"""Edges around something round, against rendered balls of exact outline."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle
from stadimeter.detectors.ball.limb import LimbEdges, limb_edges
from stadimeter.detectors.sampling import light_table
from support.scenes import draw
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.nuisances import motion
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

CAMERA = draw.CAMERA


def _scene(diameter_m: float = 0.2, depth_m: float = 1.5) -> Scene:
    """Return a ball in the middle of the picture, where its outline is a circle, before a plain wall."""
    ball = BallTarget(position_m=(0.0, 0.0, depth_m), diameter_m=diameter_m)
    return replace(draw.empty_scene(7), target=ball, backdrop=PlainBackdrop())


def _circle(scene: Scene) -> ImageCircle:
    camera = scene.camera
    return ImageCircle(x_px=camera.cx_px, y_px=camera.cy_px, radius_px=scene.target.apparent_px(camera) / 2)


def _edges(scene: Scene, circle: ImageCircle | None = None, within_px: float = 6.0) -> LimbEdges:
    edges = limb_edges(render(scene).image, circle or _circle(scene), within_px + 2.5, within_px, CAMERA)
    assert edges is not None
    return edges


def _radii(scene: Scene, edges: LimbEdges) -> np.ndarray:
    return np.hypot(*(edges.points_px - (scene.camera.cx_px, scene.camera.cy_px)).T)


@pytest.mark.parametrize("depth_m", [0.8, 1.5, 4.0, 8.0])
def test_the_edges_lie_on_the_limb_to_a_few_hundredths_of_a_pixel(depth_m: float) -> None:
    scene = _scene(depth_m=depth_m)
    radii = _radii(scene, _edges(scene))
    true_px = _circle(scene).radius_px
    assert np.median(radii) == pytest.approx(true_px, abs=0.04)
    assert np.std(radii) < 0.2
    assert len(radii) >= min(60, 3 * true_px)


def test_a_blurred_edge_is_as_wide_as_it_was_smeared() -> None:
    scene = _scene(depth_m=1.0)
    sharp, smeared = _edges(scene), _edges(motion(8)(scene), within_px=10.0)
    assert 2.2 < sharp.usual_width_px < 3.2
    assert smeared.wide_width_px > 6.0
    assert np.median(_radii(scene, smeared)) == pytest.approx(_circle(scene).radius_px, abs=0.3)


@settings(max_examples=25, deadline=None)
@given(wall=st.integers(20, 235), bias_px=st.floats(-0.8, 0.8))
def test_each_edge_moves_by_the_bias_in_proportion_to_its_contrast(wall: int, bias_px: float) -> None:
    scene = _scene()
    image, circle = np.full((480, 640, 3), wall, np.uint8), _circle(scene)
    cv2.circle(image, (round(circle.x_px), round(circle.y_px)), round(circle.radius_px), (128, 128, 128), cv2.FILLED)
    light = light_table("srgb")
    contrast = (light[128] - light[wall]) / max(light[128], light[wall])
    plain = limb_edges(image, circle, 8.5, 6.0, CAMERA)
    biased = limb_edges(image, circle, 8.5, 6.0, replace(CAMERA, edge_bias_px=bias_px))
    if plain is None or biased is None:
        assert abs(wall - 128) < 12, "where there is light and dark, there are edges"
        return
    moved = np.median(_radii(scene, biased)) - np.median(_radii(scene, plain))
    assert moved == pytest.approx(-bias_px * contrast, abs=0.02)


def test_spokes_that_leave_the_picture_are_counted_and_not_looked_along() -> None:
    scene = _scene(depth_m=1.0)
    camera, circle = scene.camera, _circle(scene)
    image: Image = np.ascontiguousarray(render(scene).image[:, int(camera.cx_px) :])
    shifted = ImageCircle(x_px=circle.x_px - int(camera.cx_px), y_px=circle.y_px, radius_px=circle.radius_px)
    edges = limb_edges(image, shifted, 8.5, 6.0, CAMERA)
    assert edges is not None
    assert edges.inside < 0.8 * edges.spokes
    assert len(edges.points_px) <= edges.inside
