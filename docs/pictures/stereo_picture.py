"""The picture of two cameras in docs/how-it-measures.md: what both see of a sheet, and their lines of sight."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from gallery import JPEG_QUALITY
from msgspec.structs import replace

from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame, Image
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.stereo import measure_pair, triangulate
from support.scenes.plane import Pose, SheetTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.stereo import calibrated_rig, pair_of, true_rig

SEED = 3
SHEET = SheetTarget(
    pose=Pose(position_m=(0.1, -0.05, 1.5), tilt_rad=math.radians(30), tilt_towards_rad=0.3, roll_rad=0.1),
    width_m=0.297 * 1.03,
    height_m=0.21 * 1.03,
)
"""It is 3 % larger than stated, so both distances can be told apart."""

GREEN, BLUE, RED, INK = (70, 170, 50), (200, 110, 30), (60, 60, 220), (40, 40, 40)
PANEL_PX = (480, 360)
VIEW_PX = (960, 300)
PX_PER_M = 520.0
ORIGIN_PX = (60, 120)


def make_stereo_picture(folder: Path) -> None:
    """Write the picture."""
    true = true_rig(SEED)
    rig = calibrated_rig(true, SEED)
    scenes = pair_of(Scene(camera=true.left, target=SHEET, seed=25, backdrop=RoomBackdrop(things=12)), true)
    images = [render(scenes.left).image, render(replace(scenes.right, seed=25)).image]
    detector = SheetDetector("sheet", SheetOptions.model_validate({"size": "A4", "tolerance": "4 mm"}))
    seen = []
    for image, lens in zip(images, (rig.left, rig.right), strict=True):
        found = detector.detect(Frame(image, 0.0, 0), lens=lens)
        measured = measure(found, detector.target_shape, lens, 0.0)
        seen.append(SeenTarget(detection=found, measurement=measured, shape=detector.target_shape))
    panels = [_with_corners(*each) for each in zip(images, (one.detection.outline_px for one in seen), strict=True)]
    view = _from_above(seen[0], seen[1], rig)
    both = np.vstack((np.hstack(panels), view))
    cv2.imwrite(str(folder / "how-stereo.jpg"), both, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _with_corners(image: Image, outline_px: Points) -> Image:
    shown = image.copy()
    corners = np.round(outline_px).astype(np.int32)
    cv2.polylines(shown, [corners.reshape(-1, 1, 2)], True, GREEN, 2, cv2.LINE_AA)
    for x, y in corners.tolist():
        cv2.circle(shown, (x, y), 6, RED, 2, cv2.LINE_AA)
    return np.asarray(cv2.resize(shown, PANEL_PX, interpolation=cv2.INTER_AREA), np.uint8)


def _from_above(left: SeenTarget, right: SeenTarget, rig: StereoRig) -> Image:
    """Draw depth to the right, and what is to the right of the cameras downwards."""
    view = np.full((VIEW_PX[1], VIEW_PX[0], 3), 255, np.uint8)
    pose = np.array((*rig.turn_rad, *rig.place_m))
    rays = [each.directions(one.detection.outline_px) for each, one in ((rig.left, left), (rig.right, right))]
    corners_m, _ = triangulate(rays[0], rays[1], pose)
    joined, figures = measure_pair(left, right, rig)
    for camera_m, name in ((np.zeros(3), "left"), (np.array(rig.place_m), "right")):
        for corner_m in corners_m:
            cv2.line(view, _place(camera_m), _place(corner_m), (200, 200, 200), 1, cv2.LINE_AA)
        cv2.circle(view, _place(camera_m), 6, INK, -1, cv2.LINE_AA)
        x, y = _place(camera_m)
        cv2.putText(view, name, (x - 55, y + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    by_size_m = corners_m * (figures.size_m / figures.distance_m)
    lines = (
        (by_size_m, BLUE, f"by its size: {figures.size_m:.3f} m +- {figures.size_sigma_m:.3f}"),
        (corners_m, GREEN, f"by both cameras together: {figures.distance_m:.3f} m +- {figures.sigma_m:.3f}"),
    )
    for number, (points_m, colour, words) in enumerate(lines):
        places = np.array([_place(each) for each in points_m], np.int32).reshape(-1, 1, 2)
        cv2.polylines(view, [places], True, colour, 2, cv2.LINE_AA)
        cv2.putText(view, words, (20, 250 + 25 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.55, colour, 1, cv2.LINE_AA)
    words = f"joined: {joined.distance_m:.3f} m +- {joined.sigma_m:.3f}; truly {math.hypot(*SHEET.position_m):.3f} m"
    cv2.putText(view, words, (480, 275), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
    return view


def _place(point_m: Points) -> tuple[int, int]:
    return round(ORIGIN_PX[0] + PX_PER_M * float(point_m[2])), round(ORIGIN_PX[1] + PX_PER_M * float(point_m[0]))


if __name__ == "__main__":
    make_stereo_picture(Path(__file__).parent)
