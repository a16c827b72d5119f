"""The pictures of docs/gallery.md: rendered scenes, measured and annotated by the commands that the page shows."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from support.scenes.backdrop import ClutterBackdrop, FloorBackdrop, Ground, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.plane import Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Target

CAMERA = CameraModel.with_focal_length(860.0, 960, 720)
SENSOR = Sensor(noise=1.0)
JPEG_QUALITY = 85
GREEN_BGR = (60, 190, 150)


def scene_of(
    target: Target, backdrop: RoomBackdrop | FloorBackdrop | PlainBackdrop | ClutterBackdrop, seed: int
) -> Scene:
    """Return a scene of the gallery's camera."""
    return Scene(camera=CAMERA, target=target, seed=seed, backdrop=backdrop, blur=Blur(sigma_px=0.7), sensor=SENSOR)


def _tags() -> GroupTarget:
    tags = [
        TagTarget(
            pose=Pose(
                position_m=(-0.17 + 0.23 * (n % 2), -0.14 + 0.21 * (n // 2), 0.8 + 0.15 * n),
                tilt_rad=math.radians(10 + 13 * n),
                tilt_towards_rad=0.7 * n,
                roll_rad=0.35 * n,
            ),
            side_m=0.08,
            number=n,
        )
        for n in range(4)
    ]
    return GroupTarget(first=tags[0], others=tuple(tags[1:]))


SHEET = SheetTarget(
    pose=Pose(position_m=(-0.25, -0.1, 1.6), tilt_rad=math.radians(28), tilt_towards_rad=0.4),
    width_m=0.297,
    height_m=0.21,
)
BALL = BallTarget(position_m=(0.1, 0.05, 1.2), diameter_m=0.2, bgr=GREEN_BGR)
GREEN = "29,86,6:90,255,255"

PICTURES: dict[str, tuple[Scene, tuple[str, ...]]] = {
    "sheet": (scene_of(SHEET, RoomBackdrop(things=12), 25), ("--sheet", "A4")),
    "rejected": (scene_of(SHEET, RoomBackdrop(things=12), 33), ("--sheet", "A4", "--explain")),
    "ball": (
        scene_of(BALL, FloorBackdrop(ground=Ground.WOOD, bgr=(110, 140, 175)), 3),
        ("--ball", "20cm", "--hsv", GREEN),
    ),
    "tags": (scene_of(_tags(), PlainBackdrop(bgr=(150, 158, 165)), 5), ("--tag", "8cm", "--family", "36h11")),
}
"""Each picture by its name, with the options that `measure` gets."""


def make_gallery(folder: Path) -> None:
    """Write every picture of the gallery.

    Args:
        folder: Where to.
    """
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        save_camera_model(work / "camera.toml", CAMERA)
        for picture, (scene, options) in PICTURES.items():
            cv2.imwrite(str(work / f"{picture}.png"), render(scene).image)
            _stadimeter(work, "measure", f"{picture}.png", "--camera", "camera.toml", *options, "--annotate", ".")
            _keep(work / f"{picture}-measured.png", folder / f"gallery-{picture}.jpg")
        _stadimeter(work, "colour", "ball.png", "--annotate", ".")
        _keep(work / "ball-colour.png", folder / "gallery-colour.jpg")


def _stadimeter(folder: Path, *arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "stadimeter", *arguments], cwd=folder, check=True)  # noqa: S603


def _keep(made: Path, kept: Path) -> None:
    cv2.imwrite(str(kept), cv2.imread(str(made)), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
