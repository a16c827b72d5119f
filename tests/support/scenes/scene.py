"""A scene: all that a picture follows from; and what is known about the picture."""

from __future__ import annotations

from msgspec import Struct, field

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image, Subsampling
from stadimeter.simulation.camera import Vector
from support.scenes.backdrop import Backdrop, ClutterBackdrop
from support.scenes.occluder import Hand, Occluder
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Target


class Scene(Struct, frozen=True, kw_only=True):
    """All that a picture follows from.

    Attributes:
        camera: Resolution, focal lengths, centre and distortion.
        target: What is to be measured; None for an empty scene.
        seed: Clutter and noise follow from it.
        backdrop: What is behind the target.
        occluder: What hides a part of it.
        blur: The lens' point spread, and motion.
        sensor: Exposure, tone curve, sharpening, noise, JPEG.
        rolling_shutter_px: By how much the picture moves, right and down, while its rows are read. The target's
            centre shows where it is at the time of the truth.
        finer: How many samples there are along a pixel, where the target is.
        others: What else is there, none of it beside or behind another so near that their blur meets.
    """

    camera: CameraModel
    target: Target | None
    seed: int
    backdrop: Backdrop = field(default_factory=ClutterBackdrop)
    occluder: Occluder | Hand | None = None
    blur: Blur = field(default_factory=Blur)
    sensor: Sensor = field(default_factory=Sensor)
    rolling_shutter_px: tuple[float, float] = (0.0, 0.0)
    finer: int = 4
    others: tuple[Target, ...] = ()


class Truth(Struct, frozen=True, kw_only=True, eq=False):
    """What is known about the target of a picture.

    Attributes:
        distance_m: Length of the straight line from the camera to the target's centre.
        depth_m: The part of that line along the optical axis.
        position_m: The centre in the camera frame: x right, y down, z forward.
        apparent_px: How large its diameter or longer side appears; of a flat target, as if it were not tilted.
        tilt_rad: Angle between its normal and the optical axis; 0 for a ball.
        outline_px: Its corners in order, or points on its limb or rim, shape ``(n, 2)``, with distortion and rolling
            shutter.
    """

    distance_m: float
    depth_m: float
    position_m: Vector
    apparent_px: float
    tilt_rad: float
    outline_px: Points


class RenderedScene(Struct, frozen=True, kw_only=True, eq=False):
    """A picture and its truth.

    Attributes:
        image: The picture, shape ``(height, width, 3)``, 8 bits a channel, blue first.
        truth: What is known about its target; None for an empty scene.
        subsampling: How coarsely its colour was stored, as a camera's driver says of its frames.
    """

    image: Image
    truth: Truth | None
    subsampling: Subsampling = "4:4:4"
