"""The interview with pictures: a sheet that is not flat, pictures of two cameras, and which distance is meant."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError
from stadimeter.workbench.setup.files import configuration_files
from stadimeter.workbench.setup.interview import Interview
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.draw import CAMERA
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

LARGE = 4


def skewed_a4() -> Image:
    """Return a picture of A4, 330 px long, whose upper side is shifted by 12 px, as that of paper that hangs badly."""
    corners = np.array([(478.8, 363.5), (808.8, 363.5), (796.8, 596.8), (466.8, 596.8)])
    image = np.full((960 * LARGE, 1280 * LARGE, 3), (70, 100, 120), np.uint8)
    outline = np.round(((corners + 0.5) * LARGE - 0.5) * 256).astype(np.int32)
    cv2.fillConvexPoly(image, outline, (228, 232, 230), shift=8)
    noise = np.random.default_rng(1).normal(0, 2, (960, 1280, 3))
    return np.clip(cv2.resize(image, (1280, 960), interpolation=cv2.INTER_AREA) + noise, 0, 255).astype(np.uint8)


@pytest.fixture
def at_sheet(tmp_path: Path) -> Interview:
    """Return an interview about that picture, up to the size."""
    cv2.imwrite(str(tmp_path / "wall.png"), skewed_a4())
    interview = Interview(tmp_path)
    for answer in ("wall.png", "sheet"):
        interview.answer(answer, confirm=False)
    return interview


@pytest.mark.long
def test_the_size_of_a_sheet_that_is_not_flat_is_asked_again_with_a_tolerance(at_sheet: Interview) -> None:
    accepted = at_sheet.answer("A4")
    assert accepted.doubt
    assert "is found with the size A4 ± 2 mm." in accepted.notes[-1]
    assert "Found the sheet" in at_sheet.answer("A4 +- 2 mm").notes[-1]
    at_sheet.answer("wall.png@1.62m")
    known = at_sheet.known
    assert known.camera_model is not None
    for name, text in configuration_files(
        {**known.answers, "wish": "near", "near_near": "1 m"}, known.camera_model
    ).items():
        (known.folder / name).write_text(text, encoding="utf-8")
    (target,) = load_configuration(known.file).targets
    assert target.options.tolerance == pytest.approx(0.002)
    measured = CliRunner().invoke(
        app, ["measure", str(known.folder / "wall.png"), "--config", str(known.file), "--json"]
    )
    assert '"status": "measured"' in measured.stdout
    refused = CliRunner().invoke(
        app, ["measure", str(known.folder / "wall.png"), "--camera", str(known.folder / "camera.toml"), "--sheet", "A4"]
    )
    assert refused.exit_code == 1
    assert 'sheet is found with tolerance = "2 mm"' in refused.stderr


@pytest.mark.long
def test_a_lens_through_which_nothing_is_measured_is_asked_again(at_sheet: Interview) -> None:
    at_sheet.answer("A4", confirm=False)
    with pytest.raises(CalibrationError, match=r'it is found with tolerance = "2 mm"$'):
        at_sheet.answer("wall.png@1.62m")
    accepted = at_sheet.answer("60 deg")
    assert accepted.doubt
    assert "nothing is measured" in accepted.notes[-1]
    assert "is found with the size A4 ± 2 mm." in accepted.notes[-1]
    assert "A5" not in accepted.notes[-1]


def ball_at(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=CAMERA, target=ball, seed=1, backdrop=PlainBackdrop())).image


def test_the_question_says_and_draws_which_distance_to_a_ball_is_meant(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "ball.png"), ball_at(1.0))
    interview = Interview(tmp_path)
    for answer in ("ball.png", "ball", "20 cm", "20,60,40:50,255,255"):
        interview.answer(answer, confirm=False)
    question = interview.question()
    assert question is not None
    assert "its nearest point" in question.text
    alone, with_picture = question.found
    assert "nearest point" in alone
    assert "near.jpg@1.1m: to its middle" in with_picture
    focal_px = []
    for answer in ("1 m", "ball.png@1.1m"):
        interview.answer(answer, confirm=False)
        assert interview.known.camera_model is not None
        focal_px.append(interview.known.camera_model.fx_px)
        interview.back()
    assert focal_px[0] == pytest.approx(focal_px[1], rel=1e-3)
    assert focal_px[0] == pytest.approx(600, rel=0.01)


def test_a_picture_of_the_folder_that_is_the_camera_needs_only_its_name(tmp_path: Path) -> None:
    (tmp_path / "balls").mkdir()
    cv2.imwrite(str(tmp_path / "balls" / "ball.png"), ball_at(1.0))
    interview = Interview(tmp_path)
    for answer in ("balls", "ball", "20 cm", "20,60,40:50,255,255"):
        interview.answer(answer, confirm=False)
    assert interview.answer("ball.png@1.1 m", confirm=False).answer == "balls/ball.png@1.1m"
    assert interview.known.camera_model is not None
    assert interview.known.camera_model.fx_px == pytest.approx(600, rel=0.01)


def mixed(folder: Path, other: tuple[int, int]) -> None:
    cv2.imwrite(str(folder / "a.png"), ball_at(1.0))
    cv2.imwrite(str(folder / "b.png"), cv2.resize(ball_at(1.0), other))


def test_pictures_of_another_aspect_are_refused_when_the_camera_is_chosen(tmp_path: Path) -> None:
    mixed(tmp_path, (480, 640))
    with pytest.raises(CalibrationError, match=r"b\.png has 480x640 px, .*a\.png has 640x480 px"):
        Interview(tmp_path).answer("a.png b.png")


def test_pictures_of_one_aspect_and_several_resolutions_are_taken(tmp_path: Path) -> None:
    mixed(tmp_path, (320, 240))
    assert not Interview(tmp_path).answer("a.png b.png", confirm=False).doubt


@pytest.mark.parametrize(("other", "is_refused"), [((480, 640), True), ((320, 240), False)])
def test_check_names_the_picture_at_which_a_run_would_stop(tmp_path: Path, other, is_refused: bool) -> None:
    mixed(tmp_path, other)
    (tmp_path / "camera.toml").write_text(
        "width_px = 640\nheight_px = 480\nfx_px = 600\nfy_px = 600\ncx_px = 319.5\ncy_px = 239.5\n"
    )
    config = tmp_path / "stadimeter.toml"
    config.write_text(
        '[camera]\ndriver = "images"\npaths = "*.png"\nmodel = "camera.toml"\n'
        '[targets.ball]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "20,60,40:50,255,255"\n'
    )
    told = CliRunner().invoke(app, ["check", str(config)])
    assert ("b.png has 480x640 px" in told.output) == is_refused, told.output
