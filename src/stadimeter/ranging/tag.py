"""Where a tag is, from the pose of its four corners."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points
from stadimeter.core.target import TagSize
from stadimeter.ranging.apparent_size import ApparentSize
from stadimeter.ranging.reading import Reading, size_noise_share
from stadimeter.ranging.similar_triangles import distance_m

SQUARE = np.array(((-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)))
"""The corners of a tag with a side of 1 in its own frame, x right, y up, in the order in which IPPE wants them."""

NO_BENDING = np.zeros(0)
FACE_ON = 1e-3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TagPose:
    """A pose of a tag.

    Attributes:
        position_m: Its centre in the camera frame, shape ``(3,)``: x right, y down, z forward.
        rotation: Its axes in the camera frame as columns, shape ``(3, 3)``: x towards its right, y towards its top.
        misfit: How far the corners appear from where the pose has them, root mean square, per unit of depth.
    """

    position_m: Points
    rotation: NDArray[np.float64]
    misfit: float

    @property
    def distance_m(self) -> float:
        """Length of the straight line from the camera to the centre."""
        return float(np.linalg.norm(self.position_m))


def read_tag(detection: Detection, size: TagSize, camera: CameraModel) -> Reading:
    """Return where a tag's centre is.

    Seen from far, a tag has two poses that explain its corners nearly equally well, mirrored about the line of sight.
    Their distances and directions hardly differ; how much they do counts in the systematic share, the more so the less
    is known which of them it is.

    Args:
        detection: A tag that was found whole.
        size: Its size.
        camera: The camera model at the picture's resolution.

    Returns:
        The position and how sure it is.
    """
    known = _mean_side(detection, size, camera)
    noise_share = size_noise_share(detection, camera, known.apparent)
    poses = tag_poses(camera.directions(detection.outline_px), size) if len(detection.outline_px) == 4 else ()
    if not poses:
        return Reading(position_m=_by_mean_side(known, detection, camera), noise_share=noise_share)
    best = poses[0]
    x_m, y_m, z_m = (float(each) for each in best.position_m)
    corner_sigma = noise_share * known.apparent / math.sqrt(2)
    doubt = sum(
        math.sqrt(_probability(other, best, corner_sigma)) * abs(other.distance_m / best.distance_m - 1)
        for other in poses[1:]
    )
    return Reading(position_m=(x_m, y_m, z_m), noise_share=noise_share, systematic_share=doubt)


def tag_poses(directions: Points, size: TagSize) -> tuple[TagPose, ...]:
    """Return the poses that a tag may have, the one that explains its corners best first.

    Both come out of T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", 2014, as OpenCV's
    ``SOLVEPNP_IPPE_SQUARE`` has it. The better one is refined by least squares. The other one is not, since from near
    by that would lead to the better one too.

    Args:
        directions: Where its corners appear, x and y per unit of depth with the lens's distortion undone, clockwise in
            the picture from its own top left one, shape ``(4, 2)``.
        size: Its size.

    Returns:
        Two poses; fewer where the corners are not those of a square in front of the camera.
    """
    corners, seen = SQUARE * size.side_m, np.ascontiguousarray(directions.reshape(4, 1, 2))
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            corners, _never_face_on(seen), np.eye(3), NO_BENDING, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        found = [_pose(corners, seen, turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
        if None in found:  # seen exactly from the front, the closed form loses a pose
            turn, shift = cv2.solvePnP(corners, seen, np.eye(3), NO_BENDING, flags=cv2.SOLVEPNP_ITERATIVE)[1:]
            found.append(_pose(corners, seen, turn, shift))
        poses = sorted((pose for pose in found if pose is not None), key=lambda pose: pose.misfit)[:2]
        return tuple(_refined(corners, seen, pose) for pose in poses[:1]) + tuple(poses[1:])
    except cv2.error:
        return ()


def ambiguity(poses: tuple[TagPose, ...]) -> float:
    """Return how far it is from certain which of two poses it is.

    Args:
        poses: The poses of a tag, the best first.

    Returns:
        The best pose's misfit as a share of the other one's: 0 for certain, 1 for no idea.
    """
    if len(poses) < 2:
        return 0.0
    return poses[0].misfit / poses[1].misfit if poses[1].misfit > 0 else 1.0


def _never_face_on(seen: Points) -> Points:
    """Return the corners with one of them moved a little, as if the tag were turned by about a milliradian.

    For a tag that faces the camera exactly, OpenCV's closed form divides zero by zero.
    """
    moved = seen.copy()
    moved[0, 0, 0] += FACE_ON * float(np.sum((seen[2, 0] - seen[0, 0]) ** 2)) / 2
    return moved


def _pose(corners: Points, seen: Points, turn: MatLike, shift: MatLike) -> TagPose | None:
    """Return a pose with its misfit; None for one that is no rotation, or has a corner behind the camera."""
    if not np.linalg.norm(turn) <= 2 * math.pi:
        return None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    position = np.asarray(shift, np.float64).reshape(3)
    placed = corners @ rotation.T + position
    if not (np.isfinite(placed).all() and placed[:, 2].min() > 0):
        return None
    missed = seen[:, 0] - placed[:, :2] / placed[:, 2:]
    return TagPose(position_m=position, rotation=rotation, misfit=float(np.sqrt(np.mean(missed**2))))


def _refined(corners: Points, seen: Points, pose: TagPose) -> TagPose:
    """Return the pose nearby whose corners appear nearest to where they were seen."""
    turn = np.asarray(cv2.Rodrigues(pose.rotation)[0], np.float64)
    shift = pose.position_m.reshape(3, 1).copy()
    better = _pose(corners, seen, *cv2.solvePnPRefineLM(corners, seen, np.eye(3), NO_BENDING, turn, shift))
    return better if better is not None and better.misfit <= pose.misfit else pose


def _probability(other: TagPose, best: TagPose, corner_sigma: float) -> float:
    """Return how probable the other pose is, if corners err normally: 1/2 at most."""
    worse = (other.misfit**2 - best.misfit**2) * SQUARE[:, :2].size / max(corner_sigma, 1e-12) ** 2
    return 1 / (1 + math.exp(min(worse / 2, 700.0)))


def _mean_side(detection: Detection, size: TagSize, camera: CameraModel) -> ApparentSize:
    """Return the side as long as its four pictures are on average: turned, a tag is measured less well."""
    apparent = (detection.width_px / camera.fx_px + detection.height_px / camera.fy_px) / 2
    return ApparentSize(size_m=size.side_m, apparent=apparent, name="side")


def _by_mean_side(known: ApparentSize, detection: Detection, camera: CameraModel) -> tuple[float, float, float]:
    """Return the position by similar triangles, for a detector that gives no corners."""
    depth_m = distance_m(1.0, known.size_m, known.apparent)
    x, y = camera.direction(*detection.centre_px)
    return (x * depth_m, y * depth_m, depth_m)
