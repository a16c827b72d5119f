from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.core.observation import PictureFlow
from stadimeter.perception.picture_flow import MIN_BLOCKS, REMEMBERED_MAX, REMEMBERED_S, FlowMeter
from stadimeter.simulation.camera import Renderer
from support.changed_pictures import Change, as_jpeg, brightness, clock, noise, shift
from support.each_case import each_case

LENS = CameraModel.with_focal_length(300.0, 320, 240)
RATE_HZ = 30.0

Draw = Callable[[int], Image]


def room(kind: str = "textured", seed: int = 3, noise: float = 2.0) -> Renderer:
    return Renderer(LENS, camera_height_m=0.12, seed=seed, noise=noise, room=kind)  # type: ignore[arg-type]


def drive(renderer: Renderer, linear_mps: float, angular_radps: float) -> Draw:
    """Return what draws the picture of a number, of a camera that drives and turns."""

    def draw(number: int) -> Image:
        at_s = number / RATE_HZ
        return renderer.render(None, 0.1, angular_radps * at_s, number, (linear_mps * at_s, 0.0))

    return draw


def flow_of(draw: Draw, pictures: int = 45, lens: CameraModel = LENS) -> PictureFlow:
    """Return the flow of the last of some pictures."""
    meter = FlowMeter()
    for number in range(pictures):
        flow = meter.measure(Frame(draw(number), number / RATE_HZ, number), lens)
    return flow


def shifts_px(flow: PictureFlow) -> list[float]:
    return [math.sqrt(max(0.0, each.shift2_px2)) for each in flow.since]


def add_noise(picture: Image, sigma: float, number: int) -> Image:
    """Add noise that is alike in all channels: the flow is measured in the green one."""
    noise = np.random.default_rng((7, number)).standard_normal(picture.shape[:2], np.float32)
    return np.clip(picture + sigma * noise[:, :, np.newaxis], 0, 255).astype(np.uint8)


@pytest.mark.long
@each_case("seed", [1, 2, 3])
@each_case(("linear_mps", "angular_radps"), [(0.1, 0.0), (0.3, 0.0), (0.0, 0.1), (0.0, 1.0), (0.3, 0.3)])
def test_a_robot_that_moves_makes_the_picture_of_a_room_flow(
    linear_mps: float, angular_radps: float, seed: int
) -> None:
    flow = flow_of(drive(room(seed=seed), linear_mps, angular_radps))
    moved = [each for each in flow.since if each.shift2_px2 > max(0.1**2, 3 * each.sigma_px2)]
    assert moved, flow


@pytest.mark.parametrize("sigma", [0.0, 2.0, 5.0, 10.0])
def test_however_strong_the_noise_a_picture_that_stands_still_does_not_flow(sigma: float) -> None:
    view = room(noise=0).render(None, 0.1, 0.0)
    flow = flow_of(lambda number: add_noise(view, sigma, number), pictures=46)
    assert len(flow.since) == 4
    for each in flow.since:
        assert abs(each.shift2_px2) <= 4 * each.sigma_px2 + 1e-9
        assert each.sigma_px2 <= 0.03, "so a shift of a third of a pixel is told from none"


def test_a_clock_that_runs_over_a_frozen_picture_does_not_make_it_flow() -> None:
    view = room().render(None, 0.1, 0.0)

    def draw(number: int) -> Image:
        picture = view.copy()
        cv2.putText(picture, f"{number / RATE_HZ:09.2f}", (60, 130), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (255, 255, 255), 3)
        return picture

    assert max(shifts_px(flow_of(draw))) == 0.0


def test_a_small_shift_is_measured_in_pixels_of_the_reduced_picture() -> None:
    wide = cv2.GaussianBlur(np.random.default_rng(5).uniform(0, 255, (240, 400)).astype(np.float32), (0, 0), 6)
    wide = np.clip(127 + 12 * (wide - wide.mean()), 0, 255)

    def draw(number: int) -> Image:
        moved = cv2.warpAffine(wide, np.array([[1.0, 0.0, -0.2 * number], [0.0, 1.0, 0.0]]), (320, 240))
        return cv2.cvtColor(np.rint(moved).astype(np.uint8), cv2.COLOR_GRAY2BGR)

    newest = flow_of(draw, pictures=12)
    (first, second) = newest.since[:2]
    for each in (first, second):
        pictures = round((11 / RATE_HZ - each.since_s) * RATE_HZ)
        assert math.sqrt(each.shift2_px2) == pytest.approx(0.1 * pictures, rel=0.15)
    assert first.focal_px == 150.0


def looks_again(draw: Draw, *, is_slid: bool) -> list[float]:
    """Return by how much three quarters of the blocks have flowed since an earlier picture, in the last looks of 50."""
    meter, found = FlowMeter(), []
    for number in range(50):
        flow = meter.measure(Frame(draw(number), number / RATE_HZ, number), LENS)
        found += [math.sqrt(max(0.0, each.shift2_px2)) for each in flow.again if each.is_slid is is_slid]
    return found[-5:]


@pytest.fixture(scope="module", params=[(0.3, 0.0), (0.2, 0.2)], ids=["ahead", "turning"])
def live(request: pytest.FixtureRequest) -> list[Image]:
    draw = drive(room(noise=2.0), *request.param)
    return [draw(number) for number in range(50)]


@pytest.mark.long
@pytest.mark.parametrize("change", [clock, noise, as_jpeg, brightness, shift])
def test_whatever_changes_in_old_pictures_they_stand_still_beside_themselves(live: list[Image], change: Change) -> None:
    rng = np.random.default_rng(1)
    old = looks_again(lambda number: change(live[number % 20], number, rng), is_slid=False)
    new = looks_again(lambda number: change(live[number], number, rng), is_slid=False)
    assert len(old) == len(new) == 5
    assert np.median(old) < 0.6
    assert min(new) > 0.8


@pytest.mark.long
def test_a_picture_that_is_scrolled_shows_no_drive_once_it_is_slid_back() -> None:
    view = room(noise=0).render(None, 0.1, 0.0)
    scrolled = looks_again(lambda number: add_noise(np.roll(view, number, axis=1), 2.0, number), is_slid=True)
    driven = looks_again(drive(room(noise=2.0), 0.3, 0.2), is_slid=True)
    assert max(scrolled) < 0.3
    assert min(driven) > 0.8


def test_pictures_are_known_again_for_a_while_and_then_forgotten() -> None:
    pictures, meter = np.random.default_rng(4).integers(0, 255, (100, 40, 160, 3), np.uint8), FlowMeter()
    lens, since_s = CameraModel.with_focal_length(150.0, 160, 40), []
    for number in range(REMEMBERED_MAX + 50):
        shown = pictures[number % 50 if number < 100 or number >= REMEMBERED_MAX else 50 + number % 50]
        flow = meter.measure(Frame(shown, number / RATE_HZ, number), lens)
        since_s += [number / RATE_HZ - each.since_s for each in flow.again if not each.is_slid]
    assert min(since_s) >= 0.5
    assert 20.0 < max(since_s) <= REMEMBERED_S


def test_a_plain_room_has_no_texture_and_no_flow() -> None:
    flow = flow_of(drive(room("plain"), 0.3, 0.3))
    assert flow.textured < 0.15
    assert [each for each in flow.since if each.blocks < MIN_BLOCKS] == []
    assert flow_of(drive(room("textured"), 0.0, 0.0)).textured > 0.5


def test_a_picture_of_another_size_begins_anew() -> None:
    meter = FlowMeter()
    renderer = room()
    for number in range(20):
        meter.measure(Frame(drive(renderer, 0.3, 0.0)(number), number / RATE_HZ, number), LENS)
    taller = np.zeros((320, 320, 3), np.uint8)
    assert meter.measure(Frame(taller, 1.0, 20), CameraModel.with_focal_length(300.0, 320, 320)).since == ()


def zoomed(picture: Image, share: float, shift_px: float) -> Image:
    """Return a picture as it looks nearer, and further to one side."""
    height_px, width_px = picture.shape[:2]
    turn = cv2.getRotationMatrix2D((width_px / 2, height_px / 2), 0.0, 1.2 + share)
    turn[0, 2] += shift_px
    return np.asarray(cv2.warpAffine(picture, turn, (width_px, height_px)), np.uint8)


def of_folder(folder: Path, names: Iterable[str]) -> list[Image]:
    pictures = [cv2.imread(str(folder / name)) for name in names]
    return [cv2.resize(each, (640, 480)) for each in pictures if each is not None]


@pytest.mark.long
def test_real_pictures_flow_when_a_drive_or_a_turn_is_made_of_them(real_pictures: Path) -> None:
    views = of_folder(real_pictures / "chessboard", ("left01.jpg", "left08.jpg", "right05.jpg"))
    views += of_folder(real_pictures / "charuco", ("img_00.jpg", "choriginal.jpg"))
    lens = CameraModel.with_focal_length(600.0, 640, 480)
    assert len(views) == 5
    for view in views:
        driven = flow_of(lambda number, view=view: add_noise(zoomed(view, 0.003 * number, 0.0), 2.0, number), lens=lens)
        turned = flow_of(lambda number, view=view: add_noise(zoomed(view, 0.0, 2.0 * number), 2.0, number), lens=lens)
        frozen = flow_of(lambda number, view=view: add_noise(zoomed(view, 0.0, 0.0), 5.0, number), lens=lens)
        for moving in (driven, turned):
            assert [each for each in moving.since if each.shift2_px2 > max(0.1, 3 * each.sigma_px2)]
        assert all(abs(each.shift2_px2) <= 4 * each.sigma_px2 for each in frozen.since)
