"""Balls as they are met outside: marked, dirty, felt or smooth ones, on floors, in hands, before pale walls.

The spread of the parameters is as wide as that of the real pictures at hand. A seed stands for one scene; what was
drawn is kept beside it, so that results can be told apart by it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from support.scenes.backdrop import Backdrop, ClutterBackdrop, FloorBackdrop, Ground, PlainBackdrop
from support.scenes.ball import BallSurface, BallTarget, Marking
from support.scenes.draw import CAMERA, MARGIN_PX, MOST_ATTEMPTS, TENNIS_M
from support.scenes.occluder import Hand
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Colour
from support.scenes.tone import Tone

BALLS: dict[str, Colour] = {
    "yellowish green": (60, 215, 190),
    "green": (70, 170, 60),
    "orange": (30, 110, 235),
    "red": (40, 40, 205),
    "blue": (190, 90, 30),
    "yellow": (40, 200, 235),
    "pink": (160, 70, 225),
}
GROUNDS: dict[Ground, tuple[tuple[Colour, ...], tuple[float, float]]] = {
    Ground.CARPET: (((92, 98, 104), (60, 80, 120), (120, 128, 138), (110, 86, 70)), (0.25, 0.6)),
    Ground.WOOD: (((80, 120, 165), (60, 90, 130), (120, 160, 195)), (0.12, 0.3)),
    Ground.CONCRETE: (((140, 145, 148), (105, 108, 112)), (0.1, 0.3)),
    Ground.GRASS: (((45, 105, 80), (40, 85, 75)), (0.4, 0.8)),
    Ground.MAT: (((90, 60, 50), (60, 62, 60), (170, 175, 175)), (0.03, 0.1)),
}
SKINS: tuple[Colour, ...] = ((105, 130, 178), (125, 150, 205), (70, 95, 140), (45, 60, 95))
TONES = (Tone.SRGB, Tone.SRGB, Tone.SRGB, Tone.GAMMA_2_4, Tone.GAMMA_1_8, Tone.S_CURVE)
WALL, CLUTTER, PALE = "wall", "clutter", "wall as bright as the ball"
BACKDROPS = (*(str(ground) for ground in Ground), WALL, CLUTTER, PALE)
HUE_MARGIN, SATURATION_SHARE, VALUE_SHARE = 12, 0.5, 0.22


class HardBall(Struct, frozen=True, kw_only=True):
    """A scene, what its user would give to the detector, and the kinds that it is of."""

    scene: Scene
    hsv: str
    colour: str
    surface: str
    backdrop: str
    has_hand: bool
    radius_px: float


def hard_ball(
    seed: int, radii_px: tuple[float, float] = (5.0, 70.0), camera: CameraModel = CAMERA, *, backdrop: str | None = None
) -> HardBall:
    """Draw a ball with a radius evenly spread over the logarithm between two."""
    rng = np.random.default_rng((seed, 80))
    colour = str(rng.choice(list(BALLS)))
    surface, surface_name = _surface(rng, seed, colour)
    kind = backdrop or str(rng.choice(BACKDROPS))
    behind, floor_bgr = _backdrop(rng, kind, BALLS[colour])
    ball = _placed(rng, camera, radii_px, surface, floor_bgr)
    hand = _hand(rng, seed, is_floor=floor_bgr is not None)
    scene = Scene(
        camera=camera,
        target=ball,
        seed=seed,
        backdrop=behind,
        occluder=hand,
        blur=Blur(
            sigma_px=float(rng.uniform(0.5, 1.3)),
            motion_px=float(rng.choice([0.0, 0.0, rng.uniform(0, 4)])),
            direction_rad=float(rng.uniform(0, math.pi)),
        ),
        sensor=hard_sensor(rng),
    )
    return HardBall(
        scene=scene,
        hsv=picked_range(BALLS[colour], floor_bgr),
        colour=colour,
        surface=surface_name,
        backdrop=kind,
        has_hand=hand is not None,
        radius_px=ball.apparent_px(camera) / 2,
    )


def silver_ball(seed: int, radii_px: tuple[float, float]) -> HardBall:
    """Draw a shiny ball of the colour of a wall, or of a grey before floors and clutter; it mirrors what is around."""
    drawn, rng = hard_ball(seed, radii_px), np.random.default_rng((seed, 81))
    grey = int(rng.integers(110, 200))
    behind = drawn.scene.backdrop
    bgr = behind.bgr if isinstance(behind, PlainBackdrop) else (grey, grey, grey)
    shiny = {"mirror": float(rng.uniform(0.3, 0.8)), "specular": float(rng.uniform(0.2, 0.8)), "surface": None}
    ball = replace(drawn.scene.target, bgr=bgr, **shiny)
    return replace(drawn, scene=replace(drawn.scene, target=ball, occluder=None), colour="silver", has_hand=False)


def hard_sensor(rng: np.random.Generator) -> Sensor:
    """Draw a camera: its tone curve, sharpening, noise and how it stores colour."""
    stored = rng.uniform()
    return Sensor(
        exposure_ev=float(rng.uniform(-0.8, 0.25)),
        tone=TONES[int(rng.integers(len(TONES)))],
        sharpening=float(rng.choice([0.0, 0.3, 0.8])),
        noise=float(rng.uniform(0.5, 2.0)),
        shot_noise=float(rng.uniform(0.005, 0.04)),
        halved_colour=bool(stored < 0.3),
        jpeg_quality=int(rng.integers(75, 97)) if stored > 0.6 else None,
    )


def picked_range(bgr: Colour, floor_bgr: Colour | None = None) -> str:
    """Return the range of colours that a user picks: around the ball's hue, without its pale and its darkest parts.

    Where the floor's own colour lies in it, the user has seen that, and has drawn the limits half way between both.
    """
    hue, saturation, value = _hsv(bgr)
    below, above, least = HUE_MARGIN, HUE_MARGIN, int(SATURATION_SHARE * saturation)
    if floor_bgr is not None:
        floor_hue, floor_saturation, _ = _hsv(floor_bgr)
        apart = (floor_hue - hue + 90) % 180 - 90
        if abs(apart) <= HUE_MARGIN and floor_saturation >= least:
            least = max(least, (saturation + floor_saturation) // 2 - 10)
            below = max(5, -apart // 2) if apart < 0 else below
            above = max(5, apart // 2) if apart > 0 else above
    return f"{(hue - below) % 180},{least},{int(VALUE_SHARE * value)}:{(hue + above) % 180},255,255"


def _hsv(bgr: Colour) -> tuple[int, int, int]:
    hue, saturation, value = cv2.cvtColor(np.array([[bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0].tolist()
    return hue, saturation, value


def _surface(rng: np.random.Generator, seed: int, colour: str) -> tuple[BallSurface, str]:
    marking = Marking(str(rng.choice([str(each) for each in Marking])))
    is_felt = bool(rng.uniform() < (0.7 if marking is Marking.SEAM else 0.2))
    pale: Colour = (225, 230, 228)
    dark: Colour = (50, 45, 45)
    # Stripes of many balls are a paler tone of the same colour.
    tone = tuple(int(0.45 * c + 0.55 * 235) for c in BALLS[colour])
    inks = [pale, (tone[0], tone[1], tone[2])] + ([dark] if marking is Marking.LOGO else [])
    surface = BallSurface(
        bgr=BALLS[colour],
        marking=marking,
        marking_bgr=inks[int(rng.integers(len(inks)))],
        dirt=float(rng.choice([0.0, 0.15, 0.4])),
        felt=float(rng.uniform(0.003, 0.012)) if is_felt else 0.0,
        seed=seed,
    )
    return surface, f"{marking}{', felt' if is_felt else ''}"


def _backdrop(rng: np.random.Generator, kind: str, ball: Colour) -> tuple[Backdrop, Colour | None]:
    if kind == CLUTTER:
        return ClutterBackdrop(), None
    if kind == WALL:
        grey = int(rng.integers(40, 226))
        return PlainBackdrop(bgr=(grey, min(255, grey + 4), min(255, grey + 8))), None
    if kind == PALE:
        level = int(0.114 * ball[0] + 0.587 * ball[1] + 0.299 * ball[2]) + int(rng.integers(-12, 13))
        return PlainBackdrop(bgr=(level, level, min(level + 4, 255))), None
    ground = Ground(kind)
    colours, contrasts = GROUNDS[ground]
    bgr = colours[int(rng.integers(len(colours)))]
    floor = FloorBackdrop(
        ground=ground,
        bgr=bgr,
        contrast=float(rng.uniform(*contrasts)),
        grain_px=float(rng.uniform(1.2, 4.0)),
        slant=float(rng.uniform(0.0, 0.8)),
        shadow=float(rng.uniform(0.3, 0.85)),
        shadow_rad=float(rng.uniform(0, math.pi)),
    )
    return floor, bgr


def _hand(rng: np.random.Generator, seed: int, *, is_floor: bool) -> Hand | None:
    if rng.uniform() > (0.15 if is_floor else 0.45):
        return None
    return Hand(
        fingers=int(rng.integers(2, 6)),
        from_rad=float(rng.uniform(0, 2 * math.pi)),
        spread_rad=float(rng.uniform(0.8, 2.2)),
        depth=float(rng.uniform(0.05, 0.4)),
        width=float(rng.uniform(0.15, 0.26)),
        bgr=SKINS[int(rng.integers(len(SKINS)))],
        seed=seed,
    )


def _placed(
    rng: np.random.Generator,
    camera: CameraModel,
    radii_px: tuple[float, float],
    surface: BallSurface,
    floor_bgr: Colour | None,
) -> BallTarget:
    lamp = (float(rng.uniform(-1, 1)), float(rng.uniform(-1, -0.3)), float(rng.uniform(-1, -0.2)))
    radius_px = float(np.exp(rng.uniform(*np.log(radii_px))))
    depth = camera.fx_px * TENNIS_M / (2 * radius_px)
    for _ in range(MOST_ATTEMPTS):
        edge = radius_px + MARGIN_PX + 4
        x_px, y_px = rng.uniform(edge, camera.width_px - edge), rng.uniform(edge, camera.height_px - edge)
        x, y = camera.direction(float(x_px), float(y_px))[:2]
        ball = BallTarget(
            position_m=(x * depth, y * depth, depth),
            diameter_m=TENNIS_M,
            bgr=surface.bgr,
            light=lamp,
            ambient=float(rng.uniform(0.2, 0.6)),
            specular=float(rng.choice([0.0, 0.0, 0.4])) if surface.felt == 0 else 0.0,
            surface=surface,
            floor_bgr=floor_bgr,
        )
        points = camera.project(ball.outline_m()[:, :2] / ball.outline_m()[:, 2:])
        last = np.array((camera.width_px, camera.height_px)) - 1 - MARGIN_PX
        if bool(((points >= MARGIN_PX) & (points <= last)).all()):
            return ball
    raise ValueError(f"no ball of a radius of {radius_px} px fits the picture")
