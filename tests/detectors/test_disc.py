"""The disc detector on rendered scenes, whose truth is exact, and on drawn shapes that are no discs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from stadimeter.detectors.disc.edges import ellipse_through
from support.each_case import each_case
from support.scenes.draw import CAMERA, disc_scene, empty_scene
from support.scenes.nuisances import distorted, motion, noise, tone
from support.scenes.render import render
from support.scenes.tone import Tone, encode
from support.through_lens import ThroughLens

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

FINER = 4
ROWS, COLUMNS = np.indices((480 * FINER, 640 * FINER), dtype=np.float32)
X, Y = (COLUMNS + 0.5) / FINER - 0.5, (ROWS + 0.5) / FINER - 0.5
CENTRE = (320.0, 240.0)

Drawn = Callable[[], np.ndarray]
"""A shape, drawn when its test runs: whoever only collects tests draws none."""


def detector(camera: CameraModel | None = None, **options: object) -> ThroughLens:
    return ThroughLens(DiscDetector("disc", DiscOptions.model_validate({"diameter": "12 cm", **options})), camera)


def seen(image: Image, prediction: Prediction | None = None, **options: object) -> Detection:
    return detector(**options).detect(Frame(image, 0.0, 0), prediction)


def picture(cover: np.ndarray, inside: float = 0.6, outside: float = 0.05, blur_px: float = 0.8) -> Image:
    """Draw what covers a share of each sample, in light, as a camera would write it."""
    share = cv2.resize(cover.astype(np.float32), (640, 480), interpolation=cv2.INTER_AREA)
    light = outside + (inside - outside) * cv2.GaussianBlur(share, (0, 0), blur_px)
    grain = np.random.default_rng(1).normal(0, 2, light.shape)
    code = np.clip(np.rint(encode(light, Tone.SRGB) + grain), 0, 255).astype(np.uint8)
    return cv2.cvtColor(code, cv2.COLOR_GRAY2BGR)


def ellipse(a: float, b: float, turned_rad: float = 0.4, centre: tuple[float, float] = CENTRE) -> np.ndarray:
    return _superellipse(a, b, 2.0, turned_rad, centre)


def _superellipse(a, b, power, turned_rad=0.4, centre=CENTRE) -> np.ndarray:
    u, v = _turned(turned_rad, centre)
    return np.abs(u / a) ** power + np.abs(v / b) ** power < 1


def _turned(turned_rad, centre=CENTRE):
    cosine, sine = math.cos(turned_rad), math.sin(turned_rad)
    return (X - centre[0]) * cosine + (Y - centre[1]) * sine, (Y - centre[1]) * cosine - (X - centre[0]) * sine


def polygon(corners: int, radius: float, height: float = 1.0) -> np.ndarray:
    angles = np.arange(corners) * 2 * math.pi / corners + 0.2
    points = np.column_stack((CENTRE[0] + radius * np.cos(angles), CENTRE[1] + height * radius * np.sin(angles)))
    fixed = np.rint(((points + 0.5) * FINER - 0.5) * 16).astype(np.int32)
    return cv2.fillPoly(np.zeros(X.shape, np.uint8), [fixed], 1, shift=4)


def rounded(a: float, b: float, radius: float) -> np.ndarray:
    u, v = _turned(0.3)
    return np.hypot(np.maximum(np.abs(u) - a + radius, 0), np.maximum(np.abs(v) - b + radius, 0)) < radius


def bumpy(radius: float, bumps: int, height: float) -> np.ndarray:
    u, v = _turned(0.0)
    return np.hypot(u, v) < radius * (1 + height * np.cos(bumps * np.arctan2(v, u)))


def ball(radius: float, towards: tuple[float, float, float]) -> np.ndarray:
    u, v = (each / radius for each in _turned(0.0))
    depth = np.sqrt(np.clip(1 - u * u - v * v, 0, 1))
    return (u * u + v * v < 1) * (0.2 + 0.8 * np.clip(towards[0] * u + towards[1] * v + towards[2] * depth, 0, 1))


def off_px(found: Detection, outline: np.ndarray) -> float:
    """Return how far the measured outline is from the true one, at worst."""
    return float(np.abs(ellipse_through(outline).distances_px(found.outline_px)).max())


@pytest.mark.long
@each_case("tilt_deg", [0, 30, 60])
@each_case("seed", [901, 903, 904])
def test_the_outline_is_found_to_a_few_hundredths_of_a_pixel(seed: int, tilt_deg: int) -> None:
    made = render(disc_scene(seed, math.radians(tilt_deg), plain=True))
    found = seen(made.image)
    assert found.status is DetectionStatus.FOUND
    assert (found.target, found.reason) == ("disc", "")
    assert off_px(found, made.truth.outline_px) < 0.08
    assert found.width_px >= found.height_px > 0
    assert 0 < found.size_sigma_px < 0.06
    assert 0.5 < found.quality <= 1


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(
    a=st.floats(20, 90),
    aspect=st.floats(0.35, 1.0),
    turned=st.floats(0, math.pi),
    x=st.floats(200, 440),
    y=st.floats(180, 300),
    is_bright=st.booleans(),
)
def test_any_ellipse_is_found_where_it_is_bright_or_dark(a, aspect, turned, x, y, is_bright) -> None:
    levels = (0.6, 0.05) if is_bright else (0.05, 0.6)
    found = seen(picture(ellipse(a, a * aspect, turned, (x, y)), *levels))
    assert found.status is DetectionStatus.FOUND, found.reason
    assert found.centre_px == pytest.approx((x, y), abs=0.05)
    # Grain alone moves the pointed ends of a small flat ellipse by 0.03 px, and a search for the worst finds more.
    off_px = max(0.1, 5 * found.size_sigma_px)
    assert (found.width_px, found.height_px) == pytest.approx((2 * a, 2 * a * aspect), abs=off_px)


SHAPES = {
    "square": lambda: rounded(40, 40, 0.1),
    "square of 24 px": lambda: rounded(12, 12, 0.1),
    "rectangle": lambda: rounded(60, 35, 0.1),
    "rounded square": lambda: rounded(40, 40, 20),
    "very rounded square": lambda: rounded(40, 40, 30),
    "rounded rectangle": lambda: rounded(60, 40, 25),
    "stadium": lambda: rounded(60, 30, 30),
    "triangle": lambda: polygon(3, 50),
    "hexagon": lambda: polygon(6, 40),
    "hexagon of 50 px": lambda: polygon(6, 25),
    "flat hexagon": lambda: polygon(6, 60, 0.6),
    "octagon": lambda: polygon(8, 40),
    "decagon": lambda: polygon(10, 60),
    "superellipse": lambda: _superellipse(60, 45, 2.6),
    "three bumps": lambda: bumpy(40, 3, 0.05),
    "five bumps": lambda: bumpy(40, 5, 0.04),
    "half a disc": lambda: ellipse(50, 50) & (CENTRE[1] > Y),
    "egg": lambda: np.hypot((X - CENTRE[0]) * (1 + 0.15 * (Y - CENTRE[1]) / 60), 0.8 * (Y - CENTRE[1])) < 60,
    "ball lit from the side": lambda: ball(50, (-0.6, -0.4, 0.69)),
    "ball lit from above": lambda: ball(50, (0.0, -0.5, 0.86)),
    "glow": lambda: np.exp(-2 * ((X - CENTRE[0]) ** 2 + (Y - CENTRE[1]) ** 2) / 50**2),
}


@pytest.mark.long
@each_case("shape", SHAPES.values(), ids=list(SHAPES))
@each_case("is_bright", [True, False])
def test_what_is_no_ellipse_is_not_taken_for_a_disc(shape: Drawn, is_bright: bool) -> None:
    found = seen(picture(shape(), *((0.6, 0.05) if is_bright else (0.05, 0.6))))
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.search(r"\d", found.reason), "the reason has figures"
    assert found.rejected, "it was looked at"
    assert all(re.search(r"\d", each.reason) for each in found.rejected[:1])


HIDDEN = {
    "a bite": (lambda: ellipse(50, 50) & (CENTRE[0] + 25 > X), 100),
    "a bite out of an ellipse": (lambda: ellipse(70, 45) & (CENTRE[1] + 25 > Y), 140),
    "an arm of its brightness": (lambda: ellipse(60, 60) | ((np.abs(Y - CENTRE[1]) < 9) & (CENTRE[0] < X)), 120),
}


@pytest.mark.parametrize(("shape", "larger_px"), HIDDEN.values(), ids=HIDDEN)
def test_a_disc_that_is_partly_hidden_is_measured_by_the_rest(shape: Drawn, larger_px: float) -> None:
    found = seen(picture(shape()))
    assert found.status is DetectionStatus.FOUND, found.reason
    assert found.centre_px == pytest.approx(CENTRE, abs=0.15)
    assert found.width_px == pytest.approx(larger_px, abs=0.25)


def test_a_disc_that_is_partly_hidden_is_less_sure_than_its_edges_are() -> None:
    whole, bitten = seen(picture(ellipse(50, 50))), seen(picture(HIDDEN["a bite"][0]()))
    assert bitten.size_sigma_px > 1.5 * whole.size_sigma_px


def test_the_disc_that_stands_out_more_is_taken_and_the_other_one_named() -> None:
    both = 1.0 * ellipse(40, 40, centre=(200, 240)) + 0.3 * ellipse(40, 40, centre=(440, 240))
    found = seen(picture(both))
    assert found.centre_px == pytest.approx((200, 240), abs=0.05)
    assert found.rejected[0].centre_px == pytest.approx((440, 240), abs=0.5)
    assert found.rejected[0].size_px == pytest.approx(80, abs=1)
    assert re.fullmatch(r"stands out less than the disc that was taken: \d+, limit \d+", found.rejected[0].reason)


def twins() -> Image:
    return picture(1.0 * ellipse(40, 40, centre=(200, 240)) + 0.95 * ellipse(40, 36, centre=(440, 240)))


def test_two_discs_that_fit_as_well_are_ambiguous_and_both_are_named() -> None:
    found = seen(twins())
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.fullmatch(
        r"ambiguous: 2 discs fit, 80 px at 200, 240 and 80 px at 440, 240; name its colour", found.reason
    )
    assert {round(each.centre_px[0], -1) for each in found.rejected[:2]} == {200, 440}


def triangles(count: int) -> np.ndarray:
    """Draw triangles all around, none of them in the middle."""
    cover = np.zeros(X.shape, np.uint8)
    places = [(x, y) for y in range(40, 460, 50) for x in range(40, 620, 50) if math.dist((x, y), CENTRE) > 110]
    for x, y in places[:count]:
        corners = np.array(((x - 15, y - 12), (x + 15, y - 8), (x - 3, y + 16)))
        cv2.fillPoly(cover, [np.rint(((corners + 0.5) * FINER - 0.5) * 16).astype(np.int32)], 1, shift=4)
    return cover


def test_a_faint_flat_ellipse_is_the_disc_on_a_wall_and_ambiguous_among_a_hundred_shapes() -> None:
    faint = 0.15 * ellipse(50, 20)
    assert seen(picture(faint)).status is DetectionStatus.FOUND
    among = seen(picture(faint + triangles(100)))
    assert among.status is DetectionStatus.NOT_FOUND
    assert re.search(r"ambiguous: .* among \d+ outlines: evidence \d+, limit \d+; name its colour", among.reason)


def coloured(*discs: tuple[np.ndarray, tuple[float, float, float]]) -> Image:
    """Draw shapes, each in its colour (blue, green and red light), over dark triangles on grey."""
    share = [cv2.resize(each.astype(np.float32), (640, 480), interpolation=cv2.INTER_AREA) for each, _ in discs]
    light = np.full((480, 640, 3), 0.2, np.float32)
    light -= 0.15 * cv2.resize(triangles(100).astype(np.float32), (640, 480), interpolation=cv2.INTER_AREA)[:, :, None]
    for cover, (_, colour) in zip(share, discs, strict=True):
        light += cover[:, :, None] * (np.array(colour, np.float32) - light)
    return np.clip(np.rint(encode(cv2.GaussianBlur(light, (0, 0), 0.8), Tone.SRGB)), 0, 255).astype(np.uint8)


def test_a_colour_that_is_named_tells_the_disc_from_others() -> None:
    green, red = (0.1, 0.6, 0.1), (0.2, 0.2, 0.9)
    image = coloured((ellipse(30, 22, centre=(290, 240)), green), (ellipse(30, 22, centre=(370, 240)), red))
    assert seen(image, hsv="40,100,60:80,255,255").centre_px == pytest.approx((290, 240), abs=0.1)
    assert seen(image, hsv="170,100,60:10,255,255").centre_px == pytest.approx((370, 240), abs=0.1)
    blue = seen(image, hsv="110,100,60:130,255,255")
    assert blue.status is DetectionStatus.NOT_FOUND
    assert any("has the disc's colour on 0% of it, limit 60%" in each.reason for each in blue.rejected)


def test_a_whole_disc_comes_before_a_larger_one_that_is_cut_off() -> None:
    found = seen(picture(ellipse(70, 70, centre=(60.0, 240.0)) | ellipse(30, 30, centre=(400.0, 240.0))))
    assert found.status is DetectionStatus.FOUND
    assert found.width_px == pytest.approx(60, abs=0.1)


@pytest.mark.parametrize("is_bright", [True, False])
def test_an_edge_bias_makes_a_bright_disc_smaller_and_a_dark_one_larger(is_bright: bool) -> None:
    image = picture(ellipse(50, 40), *((0.6, 0.05) if is_bright else (0.05, 0.6)))
    plain = detector(CAMERA).detect(Frame(image, 0.0, 0))
    biased = detector(replace(CAMERA, edge_bias_px=0.25)).detect(Frame(image, 0.0, 0))
    change = -0.5 if is_bright else 0.5
    assert biased.width_px - plain.width_px == pytest.approx(change, abs=0.02)
    assert biased.height_px - plain.height_px == pytest.approx(change, abs=0.02)


def test_a_bent_picture_of_a_disc_has_its_outline_where_the_lens_puts_it() -> None:
    scene = distorted(disc_scene(907, 0.4, plain=True))
    made = render(scene)
    found = detector(scene.camera).detect(Frame(made.image, 0.0, 0))
    assert found.status is DetectionStatus.FOUND
    nearest = np.linalg.norm(found.outline_px[:, None] - made.truth.outline_px[None], axis=2).min(axis=1)
    spacing = np.linalg.norm(np.diff(made.truth.outline_px, axis=0), axis=1).max()
    assert nearest.max() < 0.1 + spacing / 2


def test_a_linear_camera_is_believed_to_be_one() -> None:
    scene = tone(Tone.LINEAR)(disc_scene(904, 0.2, plain=True))
    made = render(scene)
    found = detector(replace(scene.camera, tone_curve="linear")).detect(Frame(made.image, 0.0, 0))
    assert off_px(found, made.truth.outline_px) < 0.08
    assert off_px(seen(made.image), made.truth.outline_px) > 0.2, "the tone curve matters in this picture"


@pytest.mark.parametrize("trouble", [noise(8), motion(4), motion(8)])
def test_noise_and_motion_move_the_outline_by_less_than_a_fifth_of_a_pixel(trouble) -> None:
    made = render(trouble(disc_scene(903, 0.5, plain=True)))
    found = seen(made.image)
    assert found.status is DetectionStatus.FOUND, found.reason
    assert off_px(found, made.truth.outline_px) < 0.2


def test_a_large_picture_is_searched_reduced_and_measured_in_full() -> None:
    image = cv2.resize(picture(ellipse(60, 45)), (4000, 3000), interpolation=cv2.INTER_CUBIC)
    found = seen(image)
    assert found.status is DetectionStatus.FOUND, found.reason
    assert (found.width_px, found.height_px) == pytest.approx((750, 562.5), abs=1.0)


@pytest.mark.long
def test_clutter_holds_nothing_round_that_is_no_ellipse() -> None:
    for seed in range(40, 46):
        found = seen(render(empty_scene(seed)).image)
        assert found.status is not DetectionStatus.FOUND or found.height_px < 0.85 * found.width_px


@pytest.mark.long
def test_most_discs_are_found_before_clutter() -> None:
    made = [render(disc_scene(seed, 0.4)) for seed in range(60, 68)]
    true = [
        each
        for each in made
        if abs(seen(each.image).width_px / ellipse_through(each.truth.outline_px).axes()[0] - 2) < 0.02
    ]
    assert len(true) >= 6
