"""The camera and the sheet of the rendered pictures."""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from support.scenes.backdrop import ClutterBackdrop, FloorBackdrop, PlainBackdrop
from support.scenes.plane import Pose, SheetTarget
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


SHEET = SheetTarget(
    pose=Pose(position_m=(-0.25, -0.1, 1.6), tilt_rad=math.radians(28), tilt_towards_rad=0.4),
    width_m=0.297,
    height_m=0.21,
)
