"""The picture of a ball in docs/how-it-measures.md, drawn from what the detector finds at each step."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle, find_blobs, search_step
from stadimeter.detectors.ball.limb import find_limb
from stadimeter.detectors.hsv import parse_hsv_range
from support.scenes import draw
from support.scenes.backdrop import FloorBackdrop, Ground
from support.scenes.ball import BallTarget
from support.scenes.nuisances import hidden
from support.scenes.render import render
from support.scenes.scene import Scene

ENLARGED = 4
"""Each pixel of the camera is this many wide."""

PANEL_PX = 90
"""Side of the part of the picture that is shown, in pixels of the camera."""

REACH_PX = 8.0
"""The limb is looked for this far inside and outside of the first circle."""

YELLOW, RED = (0, 230, 255), (40, 40, 255)
QUALITY = 88
BALL_RANGE = parse_hsv_range("29,86,6:64,255,255")


class Panel:
    """A part of a picture, enlarged, to draw upon in pixels of the whole picture."""

    def __init__(self, image: Image, centre_px: tuple[float, float]) -> None:
        self._left, self._top = (round(each) - PANEL_PX // 2 for each in centre_px)
        part = image[self._top : self._top + PANEL_PX, self._left : self._left + PANEL_PX]
        self.pixels = cv2.resize(part, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_NEAREST)

    def places(self, points_px: Points) -> np.ndarray:
        """Return where points of the picture are on the panel: a pixel's centre is in the middle of its square."""
        shown = (points_px - (self._left, self._top) + 0.5) * ENLARGED
        return np.rint(shown).astype(np.int32)

    def dots(self, points_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a dot on each point."""
        for x, y in self.places(points_px).tolist():
            cv2.circle(self.pixels, (x, y), 3, colour, cv2.FILLED, cv2.LINE_AA)

    def loop(self, points_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a closed line through points."""
        cv2.polylines(self.pixels, [self.places(points_px)], True, colour, 1, cv2.LINE_AA)

    def lines(self, starts_px: Points, ends_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a line between each pair of points."""
        for start, end in zip(self.places(starts_px).tolist(), self.places(ends_px).tolist(), strict=True):
            cv2.line(self.pixels, start, end, colour, 1, cv2.LINE_AA)


def ball_picture(path: Path) -> None:
    """Draw the search of a ball by its colour, the spokes around it, and the steps that its limb is fitted to."""
    target = BallTarget(position_m=(0.06, 0.02, 0.75), diameter_m=draw.TENNIS_M, light=(-0.6, -0.7, -0.4))
    floor = FloorBackdrop(ground=Ground.WOOD, bgr=(80, 120, 165))
    scene = Scene(camera=draw.CAMERA, target=target, seed=7, backdrop=floor)
    image = render(hidden(0.2)(scene)).image
    blob = find_blobs(image, BALL_RANGE, search_step(5.0))[0]
    limb = find_limb(image, blob.circle, REACH_PX, scene.camera)
    if limb is None:
        raise RuntimeError("the limb of the ball was not found")
    middle = (limb.circle.x_px, limb.circle.y_px)
    search, spokes, fitted = (Panel(image, middle) for _ in range(3))
    search.dots(blob.outline_px, YELLOW)
    search.loop(_around(blob.circle), RED)
    spokes.lines(*_spokes(blob.circle), YELLOW)
    fitted.loop(scene.camera.project(limb.cone.outline(90)), RED)
    fitted.dots(limb.points_px, YELLOW)
    _save(path, search, spokes, fitted)


def _spokes(circle: ImageCircle) -> tuple[Points, Points]:
    """Return where spokes begin and end: along rows and columns, whichever crosses the circle more squarely."""
    limb = _around(circle)[::4]
    way = limb - (circle.x_px, circle.y_px)
    along = np.where(np.abs(way) >= np.abs(way).max(axis=1, keepdims=True), np.sign(way), 0.0)
    return limb - REACH_PX * along, limb + REACH_PX * along


def _around(circle: ImageCircle) -> Points:
    """Return points around a circle."""
    angles = np.arange(144) * (2 * math.pi / 144)
    way = np.column_stack((np.cos(angles), np.sin(angles)))
    return np.array((circle.x_px, circle.y_px)) + circle.radius_px * way


def _save(path: Path, *panels: Panel) -> None:
    """Write panels beside each other."""
    gap = np.full((PANEL_PX * ENLARGED, 8, 3), 255, np.uint8)
    row = [each for panel in panels for each in (panel.pixels, gap)][:-1]
    cv2.imwrite(str(path), np.concatenate(row, axis=1), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    ball_picture(Path(__file__).parent / "measuring-ball.jpg")
