"""The interview with pictures: a sheet that is not flat, pictures of two cameras, and which distance is meant."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.core.frame import Image
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.draw import CAMERA
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision


def ball_at(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=CAMERA, target=ball, seed=1, backdrop=PlainBackdrop())).image


def mixed(folder: Path, other: tuple[int, int]) -> None:
    cv2.imwrite(str(folder / "a.png"), ball_at(1.0))
    cv2.imwrite(str(folder / "b.png"), cv2.resize(ball_at(1.0), other))


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
