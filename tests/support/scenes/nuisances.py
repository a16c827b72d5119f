"""The troubles that scenes are measured under, by name. Each changes one thing of a clean scene.

A trouble keeps the scene's seed, so that the target, the clutter and the noise are the same under all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from support.scenes.backdrop import ClutterBackdrop
from support.scenes.ball import BallTarget
from support.scenes.occluder import Occluder
from support.scenes.scene import Scene
from support.scenes.sensor import Blur
from support.scenes.tone import Tone

Nuisance = Callable[[Scene], Scene]

BARREL = (-0.30, 0.09, 0.001, -0.0005, 0.0)
"""A common wide-angle lens: corners are drawn in by about 8 %."""

ROLLING_SHUTTER_PX = 20.0
OCCLUDER_BGRS = ((70, 74, 82), (150, 128, 120), (120, 140, 190), (40, 38, 36))


def clean(scene: Scene) -> Scene:
    """Change nothing: point spread 0.7 px, noise 2."""
    return scene


def noise(levels: float) -> Nuisance:
    """Return the trouble of stronger noise, in code values."""
    return lambda scene: replace(scene, sensor=replace(scene.sensor, noise=levels))


def motion(length_px: float) -> Nuisance:
    """Return the trouble of motion during the exposure, in a direction that the seed decides."""

    def apply(scene: Scene) -> Scene:
        direction = float(_rng(scene, 11).uniform(0, math.pi))
        return replace(scene, blur=replace(scene.blur, motion_px=length_px, direction_rad=direction))

    return apply


def jpeg(quality: int) -> Nuisance:
    """Return the trouble of JPEG with halved colour."""
    return lambda scene: replace(scene, sensor=replace(scene.sensor, jpeg_quality=quality))


def hidden(share: float) -> Nuisance:
    """Return the trouble of something before the target, from a side that the seed decides."""

    def apply(scene: Scene) -> Scene:
        rng = _rng(scene, 12)
        side, bgr = float(rng.uniform(0, 2 * math.pi)), OCCLUDER_BGRS[rng.integers(len(OCCLUDER_BGRS))]
        return replace(scene, occluder=Occluder(share=share, from_rad=side, bgr=bgr))

    return apply


def exposure(stops: float) -> Nuisance:
    """Return the trouble of too much or too little light."""
    return lambda scene: replace(scene, sensor=replace(scene.sensor, exposure_ev=stops))


def tone(curve: Tone) -> Nuisance:
    """Return the trouble of another tone curve than the one that is assumed."""
    return lambda scene: replace(scene, sensor=replace(scene.sensor, tone=curve))


def sharpened(amount: float) -> Nuisance:
    """Return the trouble of sharpening."""
    return lambda scene: replace(scene, sensor=replace(scene.sensor, sharpening=amount))


def soft(sigma_px: float) -> Nuisance:
    """Return the trouble of a wider point spread."""
    return lambda scene: replace(scene, blur=Blur(sigma_px=sigma_px))


def specular(scene: Scene) -> Scene:
    """Make a ball glossy."""
    return _with_ball(scene, specular=0.9)


def dark_side(scene: Scene) -> Scene:
    """Light a ball from one side, with little light from elsewhere."""
    return _with_ball(scene, ambient=0.12)


def distractors(count: int) -> Nuisance:
    """Return the trouble of angular shapes of the target's colour around it, on clutter."""
    return lambda scene: replace(scene, backdrop=ClutterBackdrop(distractors=count))


def of_its_colour(scene: Scene) -> Scene:
    """Put a ball before clutter of which many shapes have its colour, some of them behind its limb."""
    return replace(scene, backdrop=ClutterBackdrop(like_target=1.0))


def rolling_shutter(scene: Scene) -> Scene:
    """Move the picture sideways while its rows are read."""
    return replace(scene, rolling_shutter_px=(ROLLING_SHUTTER_PX, 0.0))


def distorted(scene: Scene) -> Scene:
    """Look through a lens with barrel distortion, which the camera model must know."""
    return replace(scene, camera=replace(scene.camera, distortion=BARREL))


def all_in_one(scene: Scene) -> Scene:
    """Add noise 4, 4 px of motion, JPEG 80 and 10 % hidden."""
    for trouble in (noise(4), motion(4), jpeg(80), hidden(0.1)):
        scene = trouble(scene)
    return scene


BALL_NUISANCES: dict[str, Nuisance] = {
    "clean": clean,
    "noise 4": noise(4),
    "noise 8": noise(8),
    "blur 5": motion(5),
    "blur 10": motion(10),
    "blur 15": motion(15),
    "jpeg 80": jpeg(80),
    "hidden 20 %": hidden(0.2),
    "hidden 40 %": hidden(0.4),
    "specular": specular,
    "dark side": dark_side,
    "dim -2 EV": exposure(-2),
    "bright +0.7 EV": exposure(0.7),
    "12 distractors": distractors(12),
    "all in one": all_in_one,
}
"""What the ball is measured under."""

SHEET_NUISANCES: dict[str, Nuisance] = {
    "clean": clean,
    "noise 8": noise(8),
    "blur 6": motion(6),
    "jpeg 80": jpeg(80),
    "dim -2 EV": exposure(-2),
}
"""What the sheet is measured under."""

TAG_NUISANCES: dict[str, Nuisance] = {"clean": clean, "noise 8": noise(8), "blur 4": motion(4), "jpeg 80": jpeg(80)}
"""What the tag is measured under."""

CAMERA_NUISANCES: dict[str, Nuisance] = {
    "linear sensor": tone(Tone.LINEAR),
    "gamma 1/1.8": tone(Tone.GAMMA_1_8),
    "gamma 1/2.4": tone(Tone.GAMMA_2_4),
    "sRGB + s-curve": tone(Tone.S_CURVE),
    "sRGB + sharpening 0.8": sharpened(0.8),
    "PSF 1.2 px": soft(1.2),
    "rolling shutter 20 px": rolling_shutter,
    "barrel lens, known": distorted,
}
"""Cameras that differ from what is assumed of them. What they do is a bias in pixels, not a failure."""

HARDER_NUISANCES: dict[str, Nuisance] = {**CAMERA_NUISANCES, "clutter of its colour": of_its_colour}
"""Where assumptions about a ball end: other cameras, and a world in the ball's own colour."""


def _with_ball(scene: Scene, **changes: float) -> Scene:
    if not isinstance(scene.target, BallTarget):
        raise ValueError(f"only a ball can be lit differently, and the target is {scene.target}")
    return replace(scene, target=replace(scene.target, **changes))  # type: ignore[arg-type]  # all of them are floats


def _rng(scene: Scene, stream: int) -> np.random.Generator:
    return np.random.default_rng((scene.seed, stream))
