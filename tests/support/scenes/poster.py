"""Posters: printed pictures with shapes, shades and lines of text on them."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from support.scenes import draw
from support.scenes.backdrop import ClutterBackdrop
from support.scenes.plane import Pose, Posed, SheetTarget
from support.scenes.scene import Scene
from support.scenes.target import Layer, Rays
from support.scenes.tone import decode_srgb

SIZE_PX = (720, 540)
WIDTH_M, HEIGHT_M = 0.40, 0.30
WORDS = ("DISTANCE", "Pi camera", "to scale", "follow me", "1 : 20", "museum", "open daily")

# What paper and ink leave of the light.
WHITE = 0.85


class PosterTarget(Posed, Struct, frozen=True, kw_only=True):
    """A poster.

    Attributes:
        pose: Where it is.
        number: What is on it follows from this.
    """

    pose: Pose
    number: int

    @property
    def paper(self) -> SheetTarget:
        """The paper that it is printed on."""
        return SheetTarget(pose=self.pose, width_m=WIDTH_M, height_m=HEIGHT_M)

    def outline_m(self) -> Points:
        """Return its corners from its top left one on."""
        return self.paper.outline_m()

    def extent_m(self) -> Points:
        """Return its corners."""
        return self.paper.outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long its longer side appears if it is not tilted."""
        return self.paper.apparent_px(camera)

    def layer(self, rays: Rays) -> Layer:
        """Return what it covers, with its print averaged over about one sample."""
        x, y, _ = self.pose.hit(rays)
        # Samples per metre where they are densest: from there on the print has no more detail than they can show.
        steps = np.hypot(*np.gradient(x)), np.hypot(*np.gradient(y))
        across, down = (
            int(np.clip(round(size / float(np.median(step))), 8, most))
            for size, step, most in zip((WIDTH_M, HEIGHT_M), steps, SIZE_PX, strict=True)
        )
        light = _light(self.number, across, down)
        column = ((x / WIDTH_M + 0.5) * across - 0.5).astype(np.float32)
        row = ((y / HEIGHT_M + 0.5) * down - 0.5).astype(np.float32)
        shown = cv2.remap(light, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return Layer(self.paper.layer(rays).cover, np.asarray(shown, np.float32))


@lru_cache(maxsize=8)
def _light(number: int, across: int, down: int) -> NDArray[np.float32]:
    light = np.asarray(WHITE * decode_srgb(poster(number)), np.float32)
    return np.asarray(cv2.resize(light, (across, down), interpolation=cv2.INTER_AREA))


@lru_cache(maxsize=8)
def poster(number: int) -> Image:
    """Return what is on a poster, blue first: a shaded ground, shapes, and lines of text."""
    rng = np.random.default_rng((number, 77))
    width, height = SIZE_PX
    ends = rng.uniform(60, 235, (2, 3))
    share = np.linspace(0, 1, height)[:, None, None]
    image = np.ascontiguousarray(np.broadcast_to(ends[0] * (1 - share) + ends[1] * share, (height, width, 3)))
    image = image.astype(np.uint8)
    for _ in range(int(rng.integers(14, 30))):
        colour = tuple(int(each) for each in rng.integers(0, 256, 3))
        at = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        if rng.random() < 0.5:
            axes = (int(rng.integers(8, 90)), int(rng.integers(8, 90)))
            cv2.ellipse(image, at, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
        else:
            corners = at + rng.integers(-90, 90, (int(rng.integers(3, 6)), 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], colour, cv2.LINE_AA)
    for _ in range(int(rng.integers(3, 7))):
        at = (int(rng.integers(0, width - 200)), int(rng.integers(40, height)))
        word = WORDS[int(rng.integers(len(WORDS)))]
        dark = tuple(int(each) for each in rng.integers(0, 90, 3))
        cv2.putText(image, word, at, cv2.FONT_HERSHEY_DUPLEX, float(rng.uniform(0.8, 2.4)), dark, 2, cv2.LINE_AA)
    return image


def poster_scene(seed: int, side_px: float, tilt_rad: float, camera: CameraModel = draw.CAMERA) -> Scene:
    """Draw a poster of 40 x 30 cm on clutter, as far away as makes its longer side that large.

    Args:
        seed: The scene, and what is on the poster.
        side_px: How long its longer side appears when it is not tilted.
        tilt_rad: Angle between its normal and the optical axis.
        camera: The camera.
    """
    rng = np.random.default_rng((seed, 78))
    depth_m = camera.fx_px * WIDTH_M / side_px
    target = draw.first_whole(
        lambda: PosterTarget(pose=draw.pose_at(rng, camera, depth_m, tilt_rad), number=seed), camera
    )
    return Scene(camera=camera, target=target, seed=seed, backdrop=ClutterBackdrop())
