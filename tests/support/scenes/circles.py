"""Three equal discs at the corners of an equilateral triangle, printed on paper."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from support.scenes import draw
from support.scenes.backdrop import ClutterBackdrop
from support.scenes.plane import INK_BGR, DiscTarget, Pose, Posed, SheetTarget
from support.scenes.scene import Scene
from support.scenes.target import Layer, Rays
from support.scenes.tone import decode_srgb

SPACING_M, DIAMETER_M = 0.10, 0.05


class CirclesTarget(Posed, Struct, frozen=True, kw_only=True):
    """Black discs on white paper.

    Attributes:
        pose: Where the middle of the triangle is, and how it is turned.
        spacing_m: How far apart any two centres are.
        diameter_m: The diameter of each disc.
    """

    pose: Pose
    spacing_m: float = SPACING_M
    diameter_m: float = DIAMETER_M

    @property
    def paper(self) -> SheetTarget:
        """The paper that they are printed on."""
        side_m = 2 * self.spacing_m / math.sqrt(3) + 1.6 * self.diameter_m
        return SheetTarget(pose=self.pose, width_m=side_m, height_m=side_m)

    def discs(self) -> list[DiscTarget]:
        """Return the discs."""
        angles = -math.pi / 2 + np.arange(3) * 2 * math.pi / 3
        centres_m = np.column_stack((np.cos(angles), np.sin(angles))) * (self.spacing_m / math.sqrt(3))
        places = self.pose.placed(centres_m).tolist()
        return [
            DiscTarget(pose=replace(self.pose, position_m=(x, y, z)), diameter_m=self.diameter_m, bgr=INK_BGR)
            for x, y, z in places
        ]

    def outline_m(self) -> Points:
        """Return points on the three rims."""
        return np.concatenate([each.outline_m() for each in self.discs()])

    def extent_m(self) -> Points:
        """Return the corners of the paper."""
        return self.paper.outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long a side of the triangle appears if it is not tilted."""
        return camera.fx_px * self.spacing_m / self.position_m[2]

    def layer(self, rays: Rays) -> Layer:
        """Return what the paper covers, with the discs on it."""
        paper, ink = self.paper.layer(rays), decode_srgb(INK_BGR)
        covered = np.max([each.layer(rays).cover for each in self.discs()], axis=0)[:, :, None]
        return Layer(paper.cover, np.asarray(paper.light * (1 - covered) + ink * covered, np.float32))


def circles_scene(seed: int, spacing_px: float, tilt_rad: float, camera: CameraModel = draw.CAMERA) -> Scene:
    """Draw circles 10 cm apart on clutter, as far away as makes a side of their triangle that large.

    Args:
        seed: The scene.
        spacing_px: How long a side appears when it is not tilted.
        tilt_rad: Angle between its normal and the optical axis.
        camera: The camera.
    """
    rng = np.random.default_rng((seed, 79))
    depth_m = camera.fx_px * SPACING_M / spacing_px
    target = draw.first_whole(lambda: CirclesTarget(pose=draw.pose_at(rng, camera, depth_m, tilt_rad)), camera)
    return Scene(camera=camera, target=target, seed=seed, backdrop=ClutterBackdrop())
