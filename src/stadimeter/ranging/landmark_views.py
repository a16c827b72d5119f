"""Tags of known places as a picture shows them: where their corners are, and by what these may be off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Landmarks, PlacedTag
from stadimeter.core.detection import Detection, Values
from stadimeter.ranging.plane_pose import plane_poses, rectangle


class SeenLandmark(NamedTuple):
    """A tag of known place, and where it is in the picture."""

    tag: PlacedTag
    found: Detection


class LandmarkViews(NamedTuple):
    """Tags in a picture, ``n`` of them, with ``k`` things that they have in common."""

    corners_m: Values  # in the room, shape (n, 4, 3)
    arms_m: Values  # from the tag's centre, likewise
    seen: Values  # where the corners appear, x and y per unit of depth, shape (n, 8)
    noise: Values  # the covariance of these, shape (n, 8, 8)
    common: Values  # how these change with what is common to all tags, by a standard deviation each, shape (n, 8, k)
    size_sigma: float
    place_variances: Values  # of a tag's three coordinates and three turns

    def of(self, chosen: Sequence[int]) -> LandmarkViews:
        """Return some of the tags."""
        which = list(chosen)
        return self._replace(**{name: getattr(self, name)[which] for name in self._fields[:5]})


def tag_axes(tag: PlacedTag) -> Values:
    """Return a tag's axes in the room as columns: to its right, to its top, and its normal."""
    normal = np.array(tag.normal)
    sine = math.sin(tag.tilt_rad)
    up = np.array((-sine * math.cos(tag.facing_rad), -sine * math.sin(tag.facing_rad), math.cos(tag.tilt_rad)))
    right = np.cross(up, normal)
    roll_sine, roll_cosine = math.sin(tag.roll_rad), math.cos(tag.roll_rad)
    return np.column_stack((roll_cosine * right - roll_sine * up, roll_cosine * up + roll_sine * right, normal))


def views_of(seen: Sequence[SeenLandmark], landmarks: Landmarks, camera: CameraModel) -> LandmarkViews:
    """Return tags as a picture shows them, through a camera model at its resolution."""
    corners_px = np.array([each.found.outline_px for each in seen])
    arms_m = np.array([rectangle(each.tag.side_m, each.tag.side_m) @ tag_axes(each.tag).T for each in seen])
    per_px = np.tile((1 / camera.fx_px, 1 / camera.fy_px), 4)
    moved, turned = _moved_by_sides(corners_px)
    # The length of a tag's side is the difference of two lines, so each is off by its part of the square root of two.
    # The ends of a line that is fitted to evenly spread steps are off by √3 times as much as its middle, besides.
    sigmas_px = np.array([max(each.found.size_sigma_px, 1e-3) / math.sqrt(2) for each in seen])
    spread = np.concatenate((moved, math.sqrt(3) * turned), axis=2) * sigmas_px[:, None, None] * per_px[:, None]
    edge_bias = (moved.sum(axis=2) * per_px * camera.edge_bias_sigma_px)[:, :, None]
    place = [landmarks.place_sigma_m**2] * 3 + [landmarks.facing_sigma_rad**2] * 3
    return LandmarkViews(
        corners_m=arms_m + np.array([each.tag.position_m for each in seen])[:, None],
        arms_m=arms_m,
        seen=camera.directions(corners_px.reshape(-1, 2)).reshape(-1, 8),
        noise=spread @ spread.transpose(0, 2, 1),
        common=np.concatenate((_of_lens(corners_px, camera), edge_bias), axis=2),
        size_sigma=landmarks.size_relative_sigma,
        place_variances=np.array(place),
    )


def _moved_by_sides(corners_px: Values) -> tuple[Values, Values]:
    """Return the motion of corners, shape (n, 4, 2), as a side moves out by a pixel, and as it turns about its middle.

    A corner is where two sides meet: when one moves, it slides along the other. Shapes (n, 8, 4).
    """
    sides = np.roll(corners_px, -1, axis=1) - corners_px
    sides = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-9)
    outwards = np.stack((sides[:, :, 1], -sides[:, :, 0]), axis=2)
    ends: Values = np.zeros((2, len(corners_px), 4, 2, 4))  # end of a side, tag, corner, x and y, side
    side = np.arange(4)
    for end, corner in ((0, side), (1, (side + 1) % 4)):
        along = np.roll(sides, -1 if end else 1, axis=1)
        sine = (outwards * along).sum(axis=2, keepdims=True)
        ends[end][:, corner, :, side] = (along / sine).swapaxes(0, 1)
    first, second = ends.reshape(2, -1, 8, 4)
    return first + second, first - second


def _of_lens(corners_px: Values, camera: CameraModel) -> Values:
    """Return the change of directions with each part of the lens that is unsure by itself, by a standard deviation."""
    slopes = camera.sensitivities(corners_px.reshape(-1, 2))[:, 1:]
    if camera.uncertainty is None:  # only the share by which both focal lengths may be wrong is known
        both = slopes[:, :, 0] * camera.fx_px + slopes[:, :, 1] * camera.fy_px
        return np.asarray((both * camera.focal_relative_sigma).reshape(-1, 8, 1))
    values, vectors = np.linalg.eigh(camera.uncertainty.covariance())
    return np.asarray((slopes @ (vectors * np.sqrt(values.clip(0.0)))).reshape(-1, 8, len(values)))


def starts_of(seen: SeenLandmark, camera: CameraModel) -> list[tuple[Values, Values]]:
    """Return the positions and turns of the camera that the two poses of a tag give."""
    tag, axes = seen.tag, tag_axes(seen.tag)
    found = []
    for pose in plane_poses(rectangle(tag.side_m, tag.side_m), camera.directions(seen.found.outline_px)):
        # The tag's axes are known in the room and in the camera's frame; what takes one to the other is the turn.
        turn = axes @ np.array((pose.right, pose.up, pose.normal))
        found.append((np.array(tag.position_m) - turn @ np.array(pose.position_m), turn))
    return found
