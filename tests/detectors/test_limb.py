"""The limb of a ball where its surface, its floor and its shadow have edges too."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle, find_plausible, learn_colours, likely_drop
from stadimeter.detectors.ball.evidence import BallScene
from stadimeter.detectors.ball.limb import Limb, find_limb
from stadimeter.detectors.ball.search import look_by_colour
from support.each_case import each_case
from support.scenes import draw
from support.scenes.nuisances import jpeg
from support.scenes.render import render
from support.scenes.tone import Tone, decode_srgb, encode

pytestmark = pytest.mark.vision

CAMERA = draw.CAMERA
ORANGE, PALE, GREY = (40, 120, 230), (215, 225, 230), (110, 112, 115)
FINER = 8
CENTRE_PX, RADIUS_PX = (320.0, 240.0), 40.0


def _picture(*, stripe: bool = False, speckle: float = 0.0, shadow: bool = False, seed: int = 1) -> Image:
    """Paint a ball of a radius of 40 px, finer than the picture, and reduce it as a lens and a sensor do."""
    rng = np.random.default_rng(seed)
    across = np.arange(-80 * FINER, 80 * FINER) + 0.5
    x, y = np.meshgrid(across / FINER, across / FINER)
    canvas = np.full((*x.shape, 3), GREY, np.float32)
    grain = cv2.resize(rng.normal(0, speckle, (120, 120)).astype(np.float32), x.shape, interpolation=cv2.INTER_CUBIC)
    canvas += grain[:, :, None]
    if shadow:
        canvas[np.hypot(x, (y - 34) / 0.4) < RADIUS_PX] *= 0.25
    is_ball = np.hypot(x, y) < RADIUS_PX
    canvas[is_ball] = ORANGE
    if stripe:
        canvas[is_ball & (np.abs(np.hypot(x - 20, y) - 44) < 8)] = PALE
    light = cv2.GaussianBlur(decode_srgb(np.clip(canvas, 0, 255)), (0, 0), 0.7 * FINER)
    image = np.full((480, 640, 3), GREY, np.float32)
    image[160:320, 240:400] = encode(cv2.resize(light, (160, 160), interpolation=cv2.INTER_AREA), Tone.SRGB)
    noisy = image + rng.normal(0, 2, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def _find(image: Image, start: ImageCircle, within_px: float, camera: CameraModel) -> Limb | None:
    """Fit a limb as the detector does while no other ball is sure."""
    limb = find_limb(image, start, within_px, camera)
    if limb is None or not limb.is_doubtful():
        return limb
    scene = BallScene(image=image, lens=camera, is_lens_known=True, colour=None, radii_px=(5.0, math.inf), seen=[])
    return look_by_colour(scene, limb, within_px)


def _limb(image: Image) -> Limb:
    # The picture's middle is at (319.5, 239.5): pixels have their centres at whole numbers.
    start = ImageCircle(x_px=CENTRE_PX[0] + 1.5, y_px=CENTRE_PX[1] - 1.0, radius_px=RADIUS_PX - 2)
    limb = _find(image, start, 8.0, CAMERA)
    assert limb is not None
    return limb


@pytest.mark.long
@each_case("seed", [1, 2, 3])
@each_case(
    "kind", [{"stripe": True}, {"speckle": 45.0}, {"shadow": True}, {"stripe": True, "speckle": 35.0, "shadow": True}]
)
def test_stripes_speckles_and_the_shadow_are_not_the_limb(kind: dict[str, float], seed: int) -> None:
    limb = _limb(_picture(**kind, seed=seed))  # type: ignore[arg-type]  # flags and one float
    assert limb.straight_radius_px == pytest.approx(RADIUS_PX, rel=0.01)
    assert abs(limb.straight_radius_px - RADIUS_PX) < 4 * limb.radius_sigma_px


def test_colours_of_stripes_are_the_balls_and_those_of_the_floor_are_not() -> None:
    image = _picture(stripe=True, shadow=True)
    colours = learn_colours(image, ImageCircle(x_px=320.0, y_px=240.0, radius_px=RADIUS_PX))
    assert colours is not None
    # From the middle of the ball to the left and to the right: the limb is 40 pixels away.
    for row in (image[240, 319:250:-1], image[240, 320:390]):
        there = find_plausible(row[None], colours.odds)[0]
        assert there[39:41].any()
        assert not there[:34].any()
        assert not there[46:].any()


def test_colour_that_is_stored_coarsely_makes_the_radius_less_sure() -> None:
    image = render(jpeg(80)(draw.ball_scene(3))).image
    truth = render(draw.ball_scene(3)).truth
    x, y = truth.outline_px.mean(axis=0)
    start = ImageCircle(x_px=float(x), y_px=float(y), radius_px=truth.apparent_px / 2)
    fine = _find(image, start, 8.0, CAMERA)
    coarse = _find(image, start, 8.0, replace(CAMERA, subsampling="4:2:0"))
    assert fine is not None
    assert coarse is not None
    assert coarse.straight_radius_px == fine.straight_radius_px
    assert coarse.radius_sigma_px > 1.1 * fine.radius_sigma_px


def test_the_edge_of_a_shadow_is_no_step_from_the_balls_colours_to_others() -> None:
    image = np.full((100, 100, 3), (60, 110, 90), np.uint8)
    image[60:] = image[60:] // 2
    cv2.circle(image, (50, 45), 25, (40, 90, 220), -1)
    image[20:71, 25:45] = np.where(image[20:71, 25:45, 2:] > 150, image[20:71, 25:45] // 2, image[20:71, 25:45])
    colours = learn_colours(image, ImageCircle(x_px=50.0, y_px=45.0, radius_px=25.0))
    assert colours is not None
    along_ball = likely_drop(image[45:46, ::-1][:, 25:90], colours)[0]
    # From right to left across the ball: its own shade begins after 30 pixels, and it ends after 50.
    assert abs(int(along_ball.argmax()) - 49) <= 2
    assert along_ball[28:32].max() < 0.2 * along_ball.max()
