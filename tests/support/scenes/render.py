"""From a scene to a picture and its truth."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from support.scenes.backdrop import Backdrop, KeepOut
from support.scenes.scene import RenderedScene, Scene, Truth
from support.scenes.target import Layer, Lens, Patch, Target, patch_around

Plane = NDArray[np.float32]


def render(scene: Scene) -> RenderedScene:
    """Make a picture and its truth. The same scene always gives the same.

    Args:
        scene: All that the picture follows from.

    Returns:
        The picture and what is known about its target.
    """
    if scene.target is None:
        picture = scene.blur.of_pixels(_backdrop(scene, None), scene.finer)
        truth = None
    else:
        lens = _lens(scene, scene.target)
        truth = _truth(scene.target, scene, lens)
        picture = _with_target(scene, scene.target, lens, truth)
    image = scene.sensor.develop(picture, np.random.default_rng((scene.seed, 1)))
    return RenderedScene(image=image, truth=truth, subsampling=scene.sensor.subsampling)


def _with_target(scene: Scene, target: Target, lens: Lens, truth: Truth) -> Plane:
    """Return the light of a scene: the backdrop in pixels, and a patch of samples with the target in it."""
    behind = _backdrop(scene, _circle_around(truth.outline_px))
    picture = scene.blur.of_pixels(behind, scene.finer)
    for other in scene.others:
        alone = replace(scene, occluder=None)
        picture = _with_patch(alone, other, lens, _truth(other, alone, lens), (behind, picture))
    return _with_patch(scene, target, lens, truth, (behind, picture))


def _with_patch(scene: Scene, target: Target, lens: Lens, truth: Truth, before: tuple[Plane, Plane]) -> Plane:
    """Return a picture with a target added; `before` are the backdrop, and the picture without it."""
    behind, picture = before
    patch = _patch(scene, target, lens, truth)
    if patch is None:
        return picture
    samples = _over(patch.samples_of(behind), target.layer(lens.rays(patch)))
    if scene.occluder:
        samples = _over(samples, scene.occluder.layer(patch, truth.outline_px))
    pixels = patch.averaged(scene.blur.of_samples(samples, scene.finer))
    # Near the patch's own border its blur lacks what is outside, so that margin is left as it is.
    core = patch.shrunk(scene.blur.reach_px, scene.camera.width_px, scene.camera.height_px)
    down, right = core.top - patch.top, core.left - patch.left
    picture = picture.copy()
    picture[core.rows_and_columns] = pixels[down : down + core.size[1], right : right + core.size[0]]
    return picture


def _patch(scene: Scene, target: Target, lens: Lens, truth: Truth) -> Patch | None:
    """Return the part of the picture that shows more than the backdrop, with twice the blur's reach around it."""
    points = lens.project(target.extent_m())
    if scene.occluder:
        points = np.vstack((points, scene.occluder.corners_px(truth.outline_px)))
    size = (scene.camera.width_px, scene.camera.height_px)
    return patch_around(points, 2 * scene.blur.reach_px + 1, size, scene.finer)


def _over(samples: Plane, layer: Layer) -> Plane:
    cover = layer.cover[:, :, None]
    return np.asarray(samples + cover * (layer.light - samples), np.float32)


def _backdrop(scene: Scene, keep_out: KeepOut | None) -> Plane:
    keep_out = keep_out if scene.backdrop.avoids_target else None
    return _kept_backdrop(scene.backdrop, scene.camera.width_px, scene.camera.height_px, scene.seed, keep_out)


@lru_cache(maxsize=2)
def _kept_backdrop(backdrop: Backdrop, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
    """Return the backdrop; the last one is kept, since it is often seen again with other troubles."""
    light = backdrop.light(width_px, height_px, seed, keep_out)
    light.setflags(write=False)
    return light


def _circle_around(outline_px: Points) -> KeepOut:
    centre = (outline_px.min(axis=0) + outline_px.max(axis=0)) / 2
    radius = float(np.linalg.norm(outline_px - centre, axis=1).max())
    return KeepOut(centre_px=(float(centre[0]), float(centre[1])), radius_px=radius)


def _lens(scene: Scene, target: Target) -> Lens:
    """Return the lens, with the row of the target's centre as the one that a rolling shutter leaves in its place."""
    still = Lens(camera=scene.camera)
    row = float(still.project(np.array([target.position_m]))[0, 1])
    return Lens(camera=scene.camera, skew_px=scene.rolling_shutter_px, reference_row_px=row)


def _truth(target: Target, scene: Scene, lens: Lens) -> Truth:
    return Truth(
        distance_m=math.hypot(*target.position_m),
        depth_m=target.position_m[2],
        position_m=target.position_m,
        apparent_px=target.apparent_px(scene.camera),
        tilt_rad=target.tilt_rad,
        outline_px=lens.project(target.outline_m()),
    )
