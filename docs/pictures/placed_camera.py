"""The picture on where the camera is in docs/how-it-measures.md: tags in a rendered room, and the plan that follows."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from gallery import JPEG_QUALITY
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_pose import CameraPose, Landmarks
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.perception.prediction import CameraLocator
from support.scenes.placed import CAMERA, PlacedScene, placed_scene
from support.scenes.render import render
from support.scenes.room import RoomBackdrop

GREEN, BLUE, RED, GREY = (80, 180, 60), (200, 120, 30), (60, 60, 220), (120, 120, 120)
PANEL_PX = (640, 480)
MARGIN_PX = 60.0
SEED = 31
REGION = math.sqrt(5.991)
"""95 % of a normal distribution in the plane lie within so many standard deviations."""

DRAWN_LARGER = 10
"""Regions are drawn so many times as large as they are: at the scale of the plan some would be dots."""


def place_picture(path: Path) -> None:
    """Write the picture with the tags that were found, beside the plan."""
    placed = placed_scene(SEED, place_sigma_m=0.005, facing_sigma_rad=math.radians(0.5))
    made = render(replace(placed.scene, backdrop=RoomBackdrop(things=12)))
    frame = Frame(made.image, 0.0, 0)
    panels = [_with_tags(made.image, frame), _plan(placed, frame)]
    bordered = [cv2.copyMakeBorder(each, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for each in panels]
    cv2.imwrite(str(path), np.hstack(bordered), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _detector() -> TagDetector:
    return TagDetector("landmarks", TagOptions.model_validate({"side": "10 cm"}))


def _located(landmarks: Landmarks, frame: Frame) -> CameraPose:
    return CameraLocator(landmarks, _detector(), Viewpoint()).locate(frame, CAMERA)


def _with_tags(image: Image, frame: Frame) -> Image:
    shown = image.copy()
    for found in _detector().detect_all(frame, lens=CAMERA):
        if found.status is DetectionStatus.FOUND:
            corners = np.round(found.outline_px * 256).astype(np.int32)
            cv2.polylines(shown, [corners.reshape(-1, 1, 2)], True, GREEN, 4, cv2.LINE_AA, shift=8)
            x, y = found.outline_px.min(axis=0).round().astype(int).tolist()
            cv2.putText(shown, str(found.number), (x, y - 14), cv2.FONT_HERSHEY_SIMPLEX, 1.6, GREEN, 4, cv2.LINE_AA)
    return np.asarray(cv2.resize(shown, PANEL_PX, interpolation=cv2.INTER_AREA), np.uint8)


def _plan(placed: PlacedScene, frame: Frame) -> Image:
    """Return the room from above: tags, and where each of them alone and all together put the camera."""
    shown = np.full((PANEL_PX[1], PANEL_PX[0], 3), 255, np.uint8)
    tags = placed.landmarks.tags
    points = np.array([*(tag.position_m[:2] for tag in tags), placed.position_m[:2]])
    low, high = points.min(axis=0), points.max(axis=0)
    px_per_m = min((np.array(PANEL_PX) - 2 * MARGIN_PX) / np.maximum(high - low, 1e-3))
    middle = (low + high) / 2

    def pixel(x_m: float, y_m: float) -> tuple[int, int]:
        x, y = (np.array((x_m, y_m)) - middle) * px_per_m
        return round(PANEL_PX[0] / 2 + x), round(PANEL_PX[1] / 2 - y)

    for tag in tags:
        _draw_region(shown, _located(replace(placed.landmarks, tags=(tag,)), frame), pixel, px_per_m, GREY)
        x_m, y_m, _ = tag.position_m
        along = np.array((-math.sin(tag.facing_rad), math.cos(tag.facing_rad))) * 0.08
        cv2.line(
            shown, pixel(x_m - along[0], y_m - along[1]), pixel(x_m + along[0], y_m + along[1]), GREEN, 5, cv2.LINE_AA
        )
        tip = pixel(x_m + 0.2 * tag.normal[0], y_m + 0.2 * tag.normal[1])
        cv2.arrowedLine(shown, pixel(x_m, y_m), tip, GREEN, 2, cv2.LINE_AA)
        cv2.putText(shown, str(tag.number), pixel(x_m, y_m), cv2.FONT_HERSHEY_SIMPLEX, 0.7, GREEN, 2, cv2.LINE_AA)
    pose = _located(placed.landmarks, frame)
    _draw_region(shown, pose, pixel, px_per_m, RED)
    if pose.position_m is not None and pose.angles_rad is not None:
        x_m, y_m, _ = pose.position_m
        tip = pixel(x_m + 0.5 * math.cos(pose.angles_rad[0]), y_m + 0.5 * math.sin(pose.angles_rad[0]))
        cv2.arrowedLine(shown, pixel(x_m, y_m), tip, BLUE, 3, cv2.LINE_AA)
    cv2.line(shown, (20, 460), (20 + round(px_per_m), 460), GREY, 2)
    cv2.putText(shown, "1 m", (24, 450), cv2.FONT_HERSHEY_SIMPLEX, 0.6, GREY, 1, cv2.LINE_AA)
    return shown


def _draw_region(shown: NDArray[np.uint8], pose: CameraPose, pixel, px_per_m: float, colour: tuple[int, ...]) -> None:
    """Draw the 95 % region of a place, larger than it is."""
    if pose.position_m is None:
        return
    values, vectors = np.linalg.eigh(np.reshape(pose.covariance, (6, 6))[:2, :2])
    axes = tuple(max(2, round(DRAWN_LARGER * REGION * math.sqrt(each) * px_per_m)) for each in values)
    angle = -math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    cv2.ellipse(shown, pixel(*pose.position_m[:2]), axes, angle, 0, 360, colour, 2, cv2.LINE_AA)
