"""Flat things as they are met outside: sheets cut by hand, strips of tape, discs and tags, in rooms and on floors.

A seed stands for one scene; what was drawn is kept beside it, so that results can be told apart by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from support.scenes import draw
from support.scenes.backdrop import Backdrop, ClutterBackdrop, FloorBackdrop, Ground, PlainBackdrop
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.hard_balls import GROUNDS, hard_sensor, picked_range
from support.scenes.plane import PAPER_BGR, DiscTarget, Pose
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.sensor import Blur
from support.scenes.target import Colour, Lens, Target

WALL, CLUTTER, ROOM, TEXTURE = "wall", "clutter", "room", "texture"
BACKDROPS = (WALL, CLUTTER, ROOM, TEXTURE)

CARD_M = (0.100, 0.075)
"""What hand-cut cards are meant to be."""

TAPE_M = (0.127, 0.0508)
"""A strip of tape, 5 by 2 inches."""

SHEET_BGRS: tuple[Colour, ...] = (PAPER_BGR, PAPER_BGR, (70, 170, 60), (40, 200, 235), (190, 120, 40), (160, 90, 225))
TAPE_BGRS: tuple[Colour, ...] = ((250, 255, 252), (225, 232, 230), (120, 240, 130), (60, 215, 235))
"""Retro-reflective tape in a lamp's light, tape without a lamp, in a green lamp's, and yellow tape."""

STRAIGHT_M = 0.0003
"""The most by which the long sides of tape deviate: they are made by a machine."""

PALE_SPREAD = 40
"""A colour whose parts differ by less is white or grey to a user."""

LEAST_SIDE_PX = 8.0
"""No side of a sheet or a strip is shorter in the picture: less is not asked of the detector."""

LEAST_CONTRAST = 90.0
"""The mean colour of a texture is at least so many code values from the target's."""

TILTS_DEG = (0.0, 45.0)


T = TypeVar("T", bound=Target)


class HardFlat(Struct, frozen=True, kw_only=True):
    """A scene, and the kinds that it is of.

    Attributes:
        scene: The scene.
        backdrop: One of `BACKDROPS`.
        cut_m: The most by which a side deviates.
        width_m: The side along the target's own x axis, or its diameter.
        height_m: The other one.
        twins: How many others of the same kind are in the picture, as far away.
        bgr: Its colour.
    """

    scene: Scene
    backdrop: str
    cut_m: float = 0.0
    width_m: float
    height_m: float
    twins: int = 0
    bgr: Colour = PAPER_BGR

    @property
    def hsv(self) -> str:
        """The range of colours that a user picks for it: of white things all that is pale and not dark."""
        pale = max(self.bgr) - min(self.bgr) < PALE_SPREAD
        return f"0,0,{max(self.bgr) // 2}:179,70,255" if pale else picked_range(self.bgr)


def hard_sheet(
    seed: int,
    cut_m: float = 0.001,
    sizes_px: tuple[float, float] = (15.0, 60.0),
    *,
    backdrop: str | None = None,
    side_m: tuple[float, float] = CARD_M,
    tilts_deg: tuple[float, float] = TILTS_DEG,
) -> HardFlat:
    """Draw a sheet cut by hand.

    Args:
        seed: The scene.
        cut_m: The most by which a place of a side is off.
        sizes_px: Between which its longer side appears, were it not tilted.
        backdrop: One of `BACKDROPS`; any without it.
        side_m: The sides that were meant.
        tilts_deg: Between which it is tilted from the optical axis.

    Returns:
        The scene, with the sheet whole in the picture.
    """
    rng = np.random.default_rng((seed, 83))
    kind = backdrop or str(rng.choice(BACKDROPS))
    bgr = SHEET_BGRS[int(rng.integers(len(SHEET_BGRS)))]
    cut = HandCut(ends_m=cut_m, sides_m=cut_m, seed=seed) if cut_m > 0 else None

    def made(pose: Pose) -> CutSheetTarget:
        return CutSheetTarget(pose=pose, width_m=side_m[0], height_m=side_m[1], cut=cut, bgr=bgr, seed=seed)

    sheet = placed_whole(rng, made, max(side_m), sizes_px, tilts_deg)
    scene = _taken(rng, seed, sheet, backdrop_of(rng, kind, bgr))
    return HardFlat(scene=scene, backdrop=kind, cut_m=cut_m, width_m=side_m[0], height_m=side_m[1], bgr=bgr)


def hard_tape(
    seed: int,
    cut_m: float = 0.001,
    sizes_px: tuple[float, float] = (15.0, 60.0),
    *,
    backdrop: str | None = None,
    pairs: float = 0.25,
) -> HardFlat:
    """Draw a strip of tape with ends cut by hand, upright or lying; some have a twin beside them, as goals do.

    Args:
        seed: The scene.
        cut_m: The most by which a place of an end is off.
        sizes_px: Between which its longer side appears, were it not tilted.
        backdrop: One of `BACKDROPS`; any without it.
        pairs: The share of scenes with a twin.

    Returns:
        The scene, with the strips whole in the picture.
    """
    rng = np.random.default_rng((seed, 84))
    kind = backdrop or str(rng.choice(BACKDROPS))
    bgr = TAPE_BGRS[int(rng.integers(len(TAPE_BGRS)))]
    is_upright, has_twin = bool(rng.random() < 0.5), bool(rng.random() < pairs)
    apart_m = float(rng.uniform(1.5, 2.5)) * max(TAPE_M)
    sheen = float(rng.uniform(0.0, 0.08))

    def strip(pose: Pose, own_seed: int) -> CutSheetTarget:
        upright = replace(pose, roll_rad=pose.roll_rad / 3 + (math.pi / 2 if is_upright else 0.0))
        cut = HandCut(ends_m=cut_m, sides_m=STRAIGHT_M, seed=own_seed)
        return CutSheetTarget(
            pose=upright, width_m=TAPE_M[0], height_m=TAPE_M[1], cut=cut, bgr=bgr, sheen=sheen, seed=own_seed
        )

    def made(pose: Pose) -> Target:
        first = strip(pose, seed)
        if not has_twin:
            return first
        # The twin lies in the same plane, beside it.
        beside = first.pose.placed(np.array([(0.0, apart_m) if is_upright else (apart_m, 0.0)]))[0]
        second = strip(replace(pose, position_m=(float(beside[0]), float(beside[1]), float(beside[2]))), seed + 1)
        return GroupTarget(first=first, others=(second,))

    target = placed_whole(rng, made, max(TAPE_M), sizes_px, TILTS_DEG)
    behind = backdrop_of(rng, kind, bgr)
    scene = _taken(rng, seed, target, behind)
    return HardFlat(
        scene=scene, backdrop=kind, cut_m=cut_m, width_m=TAPE_M[0], height_m=TAPE_M[1], twins=int(has_twin), bgr=bgr
    )


def hard_disc(seed: int, tilts_deg: tuple[float, float] = (0.0, 60.0), *, backdrop: str | None = None) -> HardFlat:
    """Draw a disc of 12 cm, 20 to 240 px large, in any of the colours of sheets."""
    rng = np.random.default_rng((seed, 85))
    kind = backdrop or str(rng.choice(BACKDROPS))
    bgr = SHEET_BGRS[int(rng.integers(len(SHEET_BGRS)))]

    def made(pose: Pose) -> Target:
        return DiscTarget(pose=pose, diameter_m=draw.DISC_M, bgr=bgr)

    disc = placed_whole(rng, made, draw.DISC_M, (20.0, 240.0), tilts_deg)
    scene = _taken(rng, seed, disc, backdrop_of(rng, kind, bgr))
    return HardFlat(scene=scene, backdrop=kind, width_m=draw.DISC_M, height_m=draw.DISC_M, bgr=bgr)


def hard_empty(seed: int) -> Scene:
    """Draw a room or, one in five, a floor, without any target."""
    rng = np.random.default_rng((seed, 87))
    behind: Backdrop = RoomBackdrop(things=int(rng.integers(4, 18)))
    if rng.random() < 0.2:
        behind = backdrop_of(rng, TEXTURE, PAPER_BGR)
    return _taken(rng, seed, None, behind)


def backdrop_of(rng: np.random.Generator, kind: str, target_bgr: Colour) -> Backdrop:
    """Draw a backdrop of a kind; a wall differs from the target in brightness, a texture in colour."""
    if kind == CLUTTER:
        return ClutterBackdrop()
    if kind == ROOM:
        return RoomBackdrop(things=int(rng.integers(4, 14)))
    if kind == TEXTURE:
        ground = list(Ground)[int(rng.integers(len(Ground)))]
        colours, contrasts = GROUNDS[ground]
        colours = tuple(each for each in colours if math.dist(each, target_bgr) > LEAST_CONTRAST)
        if not colours:
            return backdrop_of(rng, TEXTURE, target_bgr)
        return FloorBackdrop(
            ground=ground,
            bgr=colours[int(rng.integers(len(colours)))],
            contrast=float(rng.uniform(*contrasts)),
            grain_px=float(rng.uniform(1.2, 4.0)),
            slant=float(rng.uniform(0.0, 0.8)),
            shadow=0.0,
        )
    level = 0.114 * target_bgr[0] + 0.587 * target_bgr[1] + 0.299 * target_bgr[2]
    grey = (
        int(rng.integers(25, 131)) if level > 165 else int(rng.choice([rng.integers(20, 70), rng.integers(190, 236)]))
    )
    return PlainBackdrop(bgr=(grey, grey + 5, grey + 10))


def placed_whole(
    rng: np.random.Generator,
    made: Callable[[Pose], T],
    longest_m: float,
    sizes_px: tuple[float, float],
    tilts_deg: tuple[float, float],
) -> T:
    """Return a target of a size evenly spread over its logarithm, anywhere in the picture where it is whole."""
    camera = draw.CAMERA
    for _ in range(draw.MOST_ATTEMPTS):
        size_px, tilt_deg = float(np.exp(rng.uniform(*np.log(sizes_px)))), float(rng.uniform(*tilts_deg))
        depth = camera.fx_px * longest_m / size_px
        x, y = camera.direction(*(float(rng.uniform(0, side)) for side in (camera.width_px, camera.height_px)))
        pose = Pose(
            position_m=(x * depth, y * depth, depth),
            tilt_rad=math.radians(tilt_deg),
            tilt_towards_rad=float(rng.uniform(0, 2 * math.pi)),
            roll_rad=float(rng.uniform(-draw.GREATEST_ROLL_RAD, draw.GREATEST_ROLL_RAD)),
        )
        target = made(pose)
        if _is_whole(target):
            return target
    raise ValueError(f"nothing of {sizes_px} px tilted by {tilts_deg} degrees fits the picture")


def _is_whole(target: Target) -> bool:
    """Return whether a target is inside the picture, and no corner of it nearer than the least side to another."""
    points_m = target.extent_m()
    if (points_m[:, 2] <= 0).any():
        return False
    camera = draw.CAMERA
    lens = Lens(camera=camera)
    places, corners = lens.project(points_m), lens.project(target.outline_m())
    last = np.array((camera.width_px, camera.height_px)) - 1 - draw.MARGIN_PX
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    is_large = len(corners) > 4 or float(sides.min()) >= LEAST_SIDE_PX
    return is_large and bool(((places >= draw.MARGIN_PX) & (places <= last)).all())


def _taken(rng: np.random.Generator, seed: int, target: Target | None, behind: Backdrop) -> Scene:
    """Return the scene as a camera of random quality takes it."""
    return Scene(
        camera=draw.CAMERA,
        target=target,
        seed=seed,
        backdrop=behind,
        blur=Blur(
            sigma_px=float(rng.uniform(0.5, 1.2)),
            motion_px=float(rng.choice([0.0, 0.0, rng.uniform(0, 3)])),
            direction_rad=float(rng.uniform(0, math.pi)),
        ),
        sensor=hard_sensor(rng),
    )
