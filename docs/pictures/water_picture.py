"""The picture of targets under water in docs/how-it-measures.md: one sheet in air and in water, and what turns rays."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from measuring_round import QUALITY, RED

from stadimeter.core.camera_model import CameraModel, behind_flat_port
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.measure import measure
from support.scenes import draw
from support.scenes.backdrop import PlainBackdrop
from support.scenes.plane import Pose, SheetTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.water import CAMERA, INDEX

SHEET = SheetTarget(
    pose=Pose(position_m=(0.05, 0.02, 1.0), tilt_rad=math.radians(25), tilt_towards_rad=0.5, roll_rad=0.1),
    width_m=0.297,
    height_m=0.21,
)
PANEL_PX = 400, 300
INK, BLUE, AIR_BGR, WATER_BGR = (60, 60, 60), (200, 110, 30), (255, 255, 255), (245, 230, 205)
EYE_PX, WINDOW_PX = (50, 150), 140
ANGLES_DEG = (-35, -20, 0, 20, 35)


def water_picture(path: Path) -> None:
    """Draw the sheet through air and through water with its distance, and rays that pass the window."""
    panels = [
        _measured(draw.CAMERA, (("in air", draw.CAMERA),)),
        _measured(
            CAMERA, (("under water", behind_flat_port(draw.CAMERA, "water", 0.0)), ("taken for air", draw.CAMERA))
        ),
        _rays(),
    ]
    gap = np.full((PANEL_PX[1], 8, 3), 255, np.uint8)
    row = [each for panel in panels for each in (panel, gap)][:-1]
    cv2.imwrite(str(path), np.concatenate(row, axis=1), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def _measured(seen_by: CameraModel, taken_for: tuple[tuple[str, CameraModel], ...]) -> Image:
    """Return what a camera sees, with the distances that follow from descriptions of it."""
    backdrop = PlainBackdrop(bgr=(90, 84, 80))
    image = render(Scene(camera=seen_by, target=SHEET, seed=7, backdrop=backdrop)).image
    detector = SheetDetector("sheet", SheetOptions.model_validate({"size": "A4"}))
    shown, lines = image.copy(), []
    for name, lens in taken_for:
        found = detector.detect(Frame(image, 0.0, 0), lens=lens)
        measured = measure(found, detector.target_shape, lens, 0.0)
        cv2.polylines(shown, [np.rint(found.outline_px).astype(np.int32)], True, RED, 2, cv2.LINE_AA)
        lines.append(f"{name}: {measured.distance_m:.3f} m")
    panel = np.asarray(cv2.resize(shown, PANEL_PX, interpolation=cv2.INTER_AREA), np.uint8)
    lines.append(f"truly {math.hypot(*SHEET.position_m):.3f} m")
    for number, words in enumerate(lines):
        _write(panel, words, (10, 20 + 20 * number), (255, 255, 255))
    return panel


def _rays() -> Image:
    """Return rays from a camera through a window into water, and where they seem to go."""
    width, height = PANEL_PX
    panel = np.full((height, width, 3), AIR_BGR, np.uint8)
    panel[:, WINDOW_PX:] = WATER_BGR
    for angle_rad in np.radians(ANGLES_DEG).tolist():
        slope, slope_in_water = math.tan(angle_rad), math.tan(math.asin(math.sin(angle_rad) / INDEX))
        met = EYE_PX[1] + slope * (WINDOW_PX - EYE_PX[0])
        past = width - WINDOW_PX
        start, at_window = EYE_PX, (WINDOW_PX, round(met))
        cv2.line(panel, at_window, (width, round(met + slope * past)), (200, 200, 200), 1, cv2.LINE_AA)
        cv2.line(panel, start, at_window, BLUE, 1, cv2.LINE_AA)
        cv2.line(panel, at_window, (width, round(met + slope_in_water * past)), BLUE, 1, cv2.LINE_AA)
    cv2.line(panel, (WINDOW_PX, 0), (WINDOW_PX, height), INK, 2)
    cv2.circle(panel, EYE_PX, 6, INK, cv2.FILLED, cv2.LINE_AA)
    for words, place_px in (("air", (10, 20)), ("window", (WINDOW_PX - 66, 20)), ("water", (WINDOW_PX + 10, 20))):
        _write(panel, words, place_px, INK)
    return panel


def _write(pixels: Image, words: str, place_px: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(pixels, words, place_px, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)


if __name__ == "__main__":
    water_picture(Path(__file__).parent / "how-water.jpg")
