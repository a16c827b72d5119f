"""Lit tape before the dark, and squares cut by hand on a board: flat things as robots and lessons measure by them."""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from support.scenes import draw
from support.scenes.backdrop import Backdrop, KeepOut, PlainBackdrop
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.hard_flats import HardFlat, backdrop_of, placed_whole
from support.scenes.plane import Pose
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Colour, Floats, Layer, Rays, Target
from support.scenes.tone import decode_srgb

STRIP_M = (0.0508, 0.127)
"""An upright strip of tape, 2 by 5 inches."""

BETWEEN_M = 0.2096
"""From the middle of one strip to that of its twin, 8.25 inches."""

LIT_BGRS: tuple[Colour, ...] = ((250, 255, 252), (120, 250, 140), (170, 255, 185))
"""Retro-reflective tape in the light of a white lamp, and of green ones."""

STRIP_CUT_M = 0.001
"""Their ends are off by up to so much."""

MAX_GLINTS, GLOW, GLOW_PX = 6, 0.06, (2.0, 9.0)
"""What else shines, and how much of the light goes how far astray, at most."""

SQUARE_M, BOARD_M = 0.1, (0.4, 0.3)
SQUARE_BGR: Colour = (70, 160, 60)
BOARD_BGRS: tuple[Colour, ...] = ((225, 230, 232), (150, 190, 215), (45, 45, 48))
SKEW_PX = (0.5, 1.4)
"""By how much an end of a side is off, at least and at most; both sides that meet at a corner move it."""

MOST_SKEW = 0.02
"""No end is off by more than this share of the side."""

SMALL_CAMERA = CameraModel.with_focal_length(330.0, 320, 240)


class SkewCut(HandCut, frozen=True, kw_only=True):
    """A cut along a ruler that was held askew: sides are straight, and each end is off by half of the most or more."""

    def deviation_m(self, side: int, place: Floats) -> Floats:
        """Return by how much a side lies too far out, as `HandCut.deviation_m`."""
        rng = np.random.default_rng((self.seed, 91, side))
        first, last = rng.uniform(0.5, 1.0, 2) * rng.choice((-1, 1), 2) * (self.sides_m if side % 2 else self.ends_m)
        return np.asarray(first + (last - first) * (place + 1) / 2)


class DimBackdrop(Struct, frozen=True, kw_only=True):
    """Another backdrop in a fraction of its light, as a short exposure leaves it.

    Attributes:
        inner: The other one.
        share: How much of its light is left.
    """

    inner: Backdrop
    share: float

    @property
    def avoids_target(self) -> bool:
        """As the other one."""
        return self.inner.avoids_target

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> NDArray[np.float32]:
        """Return its linear light."""
        return self.inner.light(width_px, height_px, seed, keep_out) * np.float32(self.share)


class GlowBackdrop(Struct, frozen=True, kw_only=True):
    """Another backdrop with other things that shine, and the glow that a lens spreads around all that is lit.

    Attributes:
        inner: The other one.
        bgr: The colour of what is lit.
        outlines_px: The outlines of the targets.
        glints: How many other things shine: lamps and what mirrors them, round or askew.
        glow: How much of the light of what is lit goes astray.
        reach_px: How far: the standard deviation.
    """

    inner: Backdrop
    bgr: Colour
    outlines_px: tuple[tuple[tuple[float, float], ...], ...]
    glints: int
    glow: float
    reach_px: float

    @property
    def avoids_target(self) -> bool:
        """It does not."""
        return False

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> NDArray[np.float32]:
        """Return its linear light."""
        rng = np.random.default_rng((seed, 96))
        others = np.zeros((height_px, width_px), np.float32)
        for _ in range(self.glints):
            size, level = float(np.exp(rng.uniform(0.7, 3.3))), float(rng.uniform(0.05, 1.0))
            turns = np.sort(rng.uniform(0, 2 * math.pi, int(rng.choice((3, 5, 12)))))
            rim = np.column_stack((np.cos(turns), float(rng.uniform(0.3, 1)) * np.sin(turns))) * size
            places = np.rint(4 * (rim + rng.uniform((0, 0), (width_px, height_px)))).astype(np.int32)
            cv2.fillPoly(others, [places], level, cv2.LINE_AA, 2)
        lit = others.copy()
        for outline in self.outlines_px:
            cv2.fillPoly(lit, [np.rint(4 * np.array(outline)).astype(np.int32)], 1.0, cv2.LINE_AA, 2)
        spread = others + np.float32(self.glow) * cv2.GaussianBlur(lit, (0, 0), self.reach_px)
        return self.inner.light(width_px, height_px, seed, keep_out) + spread[:, :, None] * decode_srgb(self.bgr)


class BelowTarget(GroupTarget, frozen=True, kw_only=True):
    """A board with other things on it. Its truth is that of the board."""

    def layer(self, rays: Rays) -> Layer:
        """Return what all of them cover, the board below."""
        return GroupTarget(first=self.others[0], others=(*self.others[1:], self.first)).layer(rays)


def lit_tape(seed: int, *, small: bool = False) -> HardFlat:
    """Draw two strips of lit tape side by side, before black or a room in a hundredth of its light.

    Args:
        seed: The scene.
        small: Whether the picture has 320 × 240 pixels, soft, stored as a JPEG.
    """
    rng = np.random.default_rng((seed, 92))
    bgr = LIT_BGRS[int(rng.integers(len(LIT_BGRS)))]
    sheen, skew = float(rng.uniform(0.0, 0.08)), rng.uniform(0.0, SKEW_PX[1])
    camera = SMALL_CAMERA if small else draw.CAMERA

    def strip(pose: Pose, own_seed: int) -> CutSheetTarget:
        level = replace(pose, roll_rad=pose.roll_rad / 8)
        pixel_m = pose.position_m[2] / camera.fx_px
        most_m = min(float(skew) * pixel_m, MOST_SKEW * max(STRIP_M))
        cut = SkewCut(ends_m=most_m / 3, sides_m=max(most_m, STRIP_CUT_M), seed=own_seed)
        return CutSheetTarget(
            pose=level, width_m=STRIP_M[0], height_m=STRIP_M[1], cut=cut, bgr=bgr, sheen=sheen, seed=own_seed
        )

    def made(pose: Pose) -> GroupTarget:
        first = strip(pose, seed)
        x_m, y_m, z_m = first.pose.placed(np.array([(BETWEEN_M, 0.0)]))[0].tolist()
        return GroupTarget(first=first, others=(strip(replace(pose, position_m=(x_m, y_m, z_m)), seed + 1),))

    target = placed_whole(rng, made, max(STRIP_M), (22.0, 110.0), (0.0, 35.0), camera)
    behind = before_the_dark(rng, target, bgr, camera)
    scene = taken(rng, seed, camera, target, behind, small=small)
    return HardFlat(
        scene=scene, backdrop="dark", cut_m=STRIP_CUT_M, width_m=STRIP_M[0], height_m=STRIP_M[1], twins=1, bgr=bgr
    )


def before_the_dark(rng: np.random.Generator, target: GroupTarget, bgr: Colour, camera: CameraModel) -> Backdrop:
    """Return black, or a room in a hundredth of its light, with glints and the glow of what is lit."""
    behind: Backdrop = PlainBackdrop(bgr=(int(rng.integers(3, 25)),) * 3)
    if rng.random() < 0.5:
        behind = DimBackdrop(inner=RoomBackdrop(things=int(rng.integers(4, 14))), share=float(rng.uniform(0.005, 0.03)))
    outlines = ((each.outline_m() / each.outline_m()[:, 2:])[:, :2] for each in (target.first, *target.others))
    return GlowBackdrop(
        inner=behind,
        bgr=bgr,
        outlines_px=tuple(tuple(map(tuple, camera.project(each).tolist())) for each in outlines),
        glints=int(rng.integers(MAX_GLINTS)),
        glow=float(rng.uniform(0, GLOW)),
        reach_px=float(rng.uniform(*GLOW_PX)),
    )


def cut_square(seed: int, *, board: bool = False) -> HardFlat:
    """Draw one to three green squares cut by hand on a board; with `board`, that is what is measured."""
    rng = np.random.default_rng((seed, 93 + board))
    board_bgr = BOARD_BGRS[int(rng.integers(len(BOARD_BGRS)))]
    slots = rng.permutation(3)[: int(rng.integers(1, 4))]
    places_m = [((slot - 1) * 0.13, float(rng.uniform(-0.06, 0.06))) for slot in slots.tolist()]

    def made(pose: Pose) -> Target:
        level = replace(pose, roll_rad=pose.roll_rad / 4)
        pixel_m = pose.position_m[2] / draw.CAMERA.fx_px
        # On the board, or from the first square, which is what is placed then.
        origin = (0.0, 0.0) if board else places_m[0]
        first, *squares = (
            _skewed(beside(level, place, origin), (SQUARE_M, SQUARE_M), pixel_m, SQUARE_BGR, seed + 10 * number)
            for number, place in enumerate(places_m)
        )
        around = _skewed(beside(level, (0.0, 0.0), origin), BOARD_M, pixel_m, board_bgr, seed + 1)
        if board:
            return BelowTarget(first=around, others=(first, *squares))
        return GroupTarget(first=first, others=(*squares, around))

    side_m, sizes_px = (BOARD_M, (70.0, 400.0)) if board else ((SQUARE_M, SQUARE_M), (20.0, 110.0))
    target = placed_whole(rng, made, max(side_m), sizes_px, (0.0, 20.0), draw.CAMERA)
    behind = backdrop_of(rng, ("wall", "room")[int(rng.integers(2))], board_bgr)
    scene = taken(rng, seed, draw.CAMERA, target, behind, small=False)
    bgr = board_bgr if board else SQUARE_BGR
    return HardFlat(scene=scene, backdrop="board", width_m=side_m[0], height_m=side_m[1], bgr=bgr)


def beside(pose: Pose, place_m: tuple[float, float], origin_m: tuple[float, float]) -> Pose:
    x_m, y_m, z_m = pose.placed(np.array([place_m]) - origin_m)[0].tolist()
    return replace(pose, position_m=(x_m, y_m, z_m))


def _skewed(pose: Pose, side_m: tuple[float, float], pixel_m: float, bgr: Colour, seed: int) -> CutSheetTarget:
    most_m = min(np.random.default_rng((seed, 95)).uniform(*SKEW_PX) * pixel_m, MOST_SKEW * min(side_m))
    cut = SkewCut(ends_m=most_m, sides_m=most_m, seed=seed)
    return CutSheetTarget(pose=pose, width_m=side_m[0], height_m=side_m[1], cut=cut, bgr=bgr, seed=seed)


def taken(
    rng: np.random.Generator, seed: int, camera: CameraModel, target: Target, behind: Backdrop, *, small: bool
) -> Scene:
    """Return the scene as a camera takes it; of small pictures a soft one, that stores JPEGs."""
    blur = Blur(
        sigma_px=float(rng.uniform(0.5, 1.5) if small else rng.uniform(0.5, 1.0)),
        motion_px=float(rng.choice([0.0, 0.0, rng.uniform(0, 1.5)])),
        direction_rad=float(rng.uniform(0, math.pi)),
    )
    sensor = Sensor(
        exposure_ev=float(rng.uniform(-0.6, 0.25)),
        sharpening=float(rng.choice([0.0, 0.3])),
        noise=float(rng.uniform(0.5, 2.0)),
        shot_noise=float(rng.uniform(0.005, 0.03)),
        jpeg_quality=int(rng.integers(70, 93)) if small or rng.random() < 0.5 else None,
    )
    return Scene(camera=camera, target=target, seed=seed, backdrop=behind, blur=blur, sensor=sensor)
