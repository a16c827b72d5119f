"""A picture of docs/how-it-measures.md: what each step of measuring a sheet finds in a rendered scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.sampling import reduced, to_full_scale
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.detectors.sheet.evidence import SearchedPicture, find_quadrilaterals, pale_masks, quick_masks
from stadimeter.ranging.flat import sheet_poses
from stadimeter.ranging.measure import measure
from stadimeter.ranging.plane_pose import RectanglePose
from support.scenes.plane import Pose, SheetTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor

GREEN, YELLOW, RED, BLUE = (80, 200, 60), (0, 210, 255), (70, 70, 235), (235, 140, 40)
PANEL_PX = (480, 360)
ZOOMED_PX = 10.0
"""The zoomed panel reaches this far from a corner, to both sides."""

CAMERA = CameraModel.with_focal_length(860.0, 960, 720)
JPEG_QUALITY = 85
SHEET = SheetTarget(
    pose=Pose(position_m=(-0.25, -0.1, 1.6), tilt_rad=math.radians(28), tilt_towards_rad=0.4),
    width_m=0.297,
    height_m=0.21,
)


def sheet_in_a_room(things: int = 12) -> Image:
    """Return a picture of a sheet of A4 among things in a room, 1.6225 m away and tilted by 28°."""
    room, blur, sensor = RoomBackdrop(things=things), Blur(sigma_px=0.7), Sensor(noise=1.0)
    return render(Scene(camera=CAMERA, target=SHEET, seed=25, backdrop=room, blur=blur, sensor=sensor)).image


def make_steps(folder: Path) -> None:
    """Write the picture."""
    _write(folder / "how-sheet.jpg", _sheet_steps())


def _sheet_steps() -> list[Image]:
    image = sheet_in_a_room()
    detector = SheetDetector("sheet", SheetOptions.model_validate({"size": "A4"}))
    small, scale = reduced(image, 480)
    picture = SearchedPicture.of(small)
    outlines = find_quadrilaterals([*quick_masks(picture), *pale_masks(picture)], 5.0)
    frame = Frame(image, 0.0, 0)
    found = detector.detect(frame, lens=CAMERA)
    points = detector.edge_points(frame, found, lens=CAMERA)
    sigma = found.size_sigma_px / CAMERA.fx_px
    pose = sheet_poses(CAMERA.directions(found.outline_px), detector.target_shape, sigma, sigma)[0].pose
    shown = _with_pose(image, pose, SHEET.width_m)
    return _panels(image, to_full_scale(outlines, scale), found, points, _labelled(shown, detector, found))


def _panels(image: Image, outlines: Points, found: Detection, points: Points, last: Image) -> list[Image]:
    """Return the outlines that were found, the one that was taken, a corner of it from near by, and its pose."""
    faded = cv2.addWeighted(image, 0.5, np.full_like(image, 255), 0.5, 0)
    every, taken = faded.copy(), faded.copy()
    _draw(every, outlines, YELLOW, 2)
    _draw(taken, [np.array(each.corners_px) for each in found.rejected if each.corners_px], RED, 2)
    _draw(taken, [found.outline_px], GREEN, 3)
    return [every, taken, _corner(image, found.outline_px, points), last]


def _corner(image: Image, outline_px: Points, points: Points) -> Image:
    """Return the second corner, enlarged, with the steps along the sides and the lines that were fitted to them."""
    wide, high = PANEL_PX
    times = high / (2 * ZOOMED_PX)
    left_top = outline_px[1] - (wide / times / 2, ZOOMED_PX)
    view = np.array(((times, 0, -times * left_top[0]), (0, times, -times * left_top[1])))
    shown = cv2.warpAffine(image, view, PANEL_PX, flags=cv2.INTER_NEAREST)
    _draw(shown, [(outline_px - left_top) * times], GREEN, 2)
    for x, y in (points - left_top) * times:
        if 0 <= x < wide and 0 <= y < high:
            cv2.circle(shown, (round(x), round(y)), 5, YELLOW, -1, cv2.LINE_AA)
    return np.asarray(shown, np.uint8)


def _with_pose(image: Image, pose: RectanglePose, size_m: float) -> Image:
    """Return the picture with the axes of a target: to its right, to its top, and towards its front."""
    shown = image.copy()
    middle = np.array(pose.position_m)
    for axis, colour in ((pose.right, RED), (pose.up, GREEN), (pose.normal, BLUE)):
        ends = np.stack((middle, middle + 0.6 * size_m * np.array(axis)))
        start, end = CAMERA.project(ends[:, :2] / ends[:, 2:]).round().astype(int).tolist()
        cv2.arrowedLine(shown, start, end, colour, 4, cv2.LINE_AA, tipLength=0.15)
    return shown


def _labelled(image: Image, detector: SheetDetector, found: Detection) -> Image:
    """Write the distance and its standard deviation into a picture."""
    measured = measure(found, detector.target_shape, CAMERA, 0.0)
    text = f"{measured.distance_m:.3f} m +- {measured.sigma_m:.4f}"
    cv2.rectangle(image, (0, image.shape[0] - 60), (470, image.shape[0]), (255, 255, 255), -1)
    cv2.putText(image, text, (12, image.shape[0] - 18), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (30, 30, 30), 2, cv2.LINE_AA)
    return image


def _draw(image: NDArray[np.uint8], outlines: Sequence[Points] | Points, colour: tuple[int, ...], width: int) -> None:
    # Eight binary places: outlines are drawn where they were found, not in whole pixels.
    fixed = [np.round(np.asarray(each) * 256).astype(np.int32).reshape(-1, 1, 2) for each in outlines]
    cv2.polylines(image, fixed, True, colour, width, cv2.LINE_AA, shift=8)


def _write(path: Path, panels: Sequence[Image]) -> None:
    """Write panels numbered from 1, two in a row."""
    numbered = []
    for number, panel in enumerate(panels, 1):
        fitted = cv2.resize(panel, PANEL_PX, interpolation=cv2.INTER_AREA)
        cv2.circle(fitted, (24, 24), 18, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.putText(fitted, str(number), (15, 33), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (30, 30, 30), 2, cv2.LINE_AA)
        numbered.append(cv2.copyMakeBorder(fitted, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255)))
    rows = [np.hstack(numbered[:2]), np.hstack(numbered[2:])]
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


if __name__ == "__main__":
    make_steps(Path(__file__).parent)
