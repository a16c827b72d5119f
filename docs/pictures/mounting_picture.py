"""The picture of a view in docs/site.md: a view that was saved, the same view turned, and the features that agree."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from stadimeter.perception.mounting import MIN_INLIERS, NEAR, fit_view_motion, look_at, match_features
from support.watched_room import LENS, Pose, WatchedRoom

SEED, NOON = 3, 720
TIMES_LONGER = 10
GREEN, WHITE = (80, 200, 60), (255, 255, 255)
JPEG_QUALITY = 80


def make_mounting_picture(path: Path) -> None:
    """Write both views side by side, with the ways of the features in the second."""
    room = WatchedRoom(SEED)
    pose = Pose(pan_deg=0.5, roll_deg=0.3)
    taken = room.pictures(NOON), room.pictures(NOON + 1, pose)
    then, now = (look_at(each, LENS) for each in taken)
    theirs, ours = match_features(then.features, now.features, NEAR)
    before, after = then.features["place"][theirs], now.features["place"][ours]
    motion, agrees = fit_view_motion(before, after, LENS.fx_px, MIN_INLIERS)
    saved, turned = (each[0].copy() for each in taken)
    for at, to in zip(LENS.project(before[agrees]), LENS.project(after[agrees]), strict=True):
        cv2.circle(saved, at.round().astype(int), 3, GREEN, 1, cv2.LINE_AA)
        far = to + TIMES_LONGER * (to - at)
        cv2.line(turned, to.round().astype(int), far.round().astype(int), GREEN, 1, cv2.LINE_AA)
    both = np.hstack((saved, turned))
    words = f"turned by {np.degrees(motion.rotation_rad):.2f} deg, {motion.inliers} features agree"
    cv2.rectangle(both, (LENS.width_px, 0), (2 * LENS.width_px, 28), (40, 40, 40), -1)
    cv2.putText(both, words, (LENS.width_px + 10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.55, WHITE, 1, cv2.LINE_AA)
    cv2.imwrite(
        str(path),
        cv2.resize(both, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA),
        [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
    )


if __name__ == "__main__":
    make_mounting_picture(Path(__file__).with_name("mounting.jpg"))
