"""The pictures of balls and discs in docs/how-it-measures.md, drawn from what the detectors find at each step."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle, find_blobs, search_step
from stadimeter.detectors.ball.limb import find_limb
from stadimeter.detectors.disc.edges import THOROUGHLY, EdgePicture, Ellipse, Lens, measure_ellipse
from stadimeter.detectors.disc.search import View, find_outlines
from stadimeter.detectors.hsv import parse_hsv_range
from stadimeter.detectors.sampling import Region
from support.scenes import draw
from support.scenes.backdrop import FloorBackdrop, Ground, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.nuisances import hidden
from support.scenes.plane import DiscTarget, Pose
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.target import Target

ENLARGED = 4
"""Each pixel of the camera is this many wide, unless a panel says otherwise."""

PANEL_PX = 90
"""Side of the part of the picture that is shown then, in pixels of the camera."""

REACH_PX = 8.0
"""The limb is looked for this far inside and outside of the first circle."""

YELLOW, RED, BLUE = (0, 230, 255), (40, 40, 255), (255, 160, 0)
QUALITY = 88
BALL_RANGE = parse_hsv_range("29,86,6:64,255,255")


class Panel:
    """A part of a picture, enlarged, to draw upon in pixels of the whole picture."""

    def __init__(self, image: Image, centre_px: tuple[float, float], enlarged: int = ENLARGED) -> None:
        side_px, self._enlarged = PANEL_PX * ENLARGED // enlarged, enlarged
        self._left, self._top = (round(each) - side_px // 2 for each in centre_px)
        part = image[self._top : self._top + side_px, self._left : self._left + side_px]
        self.pixels = cv2.resize(part, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_NEAREST)

    def places(self, points_px: Points) -> np.ndarray:
        """Return where points of the picture are on the panel: a pixel's centre is in the middle of its square."""
        shown = (points_px - (self._left, self._top) + 0.5) * self._enlarged
        return np.rint(shown).astype(np.int32)

    def dots(self, points_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a dot on each point."""
        for x, y in self.places(points_px).tolist():
            cv2.circle(self.pixels, (x, y), 3, colour, cv2.FILLED, cv2.LINE_AA)

    def loop(self, points_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a closed line through points."""
        cv2.polylines(self.pixels, [self.places(points_px)], True, colour, 1, cv2.LINE_AA)

    def write(self, words: str, place_px: Points, colour: tuple[int, int, int]) -> None:
        """Write words that begin at a place of the picture."""
        x, y = self.places(place_px).tolist()
        cv2.putText(self.pixels, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)

    def lines(self, starts_px: Points, ends_px: Points, colour: tuple[int, int, int]) -> None:
        """Draw a line between each pair of points."""
        for start, end in zip(self.places(starts_px).tolist(), self.places(ends_px).tolist(), strict=True):
            cv2.line(self.pixels, start, end, colour, 1, cv2.LINE_AA)


def ball_picture(path: Path) -> None:
    """Draw the search of a ball by its colour, the spokes around it, and the steps that its limb is fitted to."""
    target = BallTarget(position_m=(0.06, 0.02, 0.75), diameter_m=draw.TENNIS_M, light=(-0.6, -0.7, -0.4))
    scene = _scene(target, floor=True)
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
    save(path, search, spokes, fitted)


def disc_picture(path: Path) -> None:
    """Draw the outline of a disc at one level, the lines across it, and the ellipse through its edges."""
    pose = Pose(position_m=(0.05, -0.02, 1.0), tilt_rad=math.radians(45), tilt_towards_rad=0.6)
    image = render(_scene(DiscTarget(pose=pose, diameter_m=draw.DISC_M), floor=False)).image
    view, lens = View.of(image, Region.whole(image)), Lens(camera=draw.CAMERA)
    outline = find_outlines(view.grey, 9.0, bright=True, dark=True).ellipses[0]
    start, is_bright = view.in_full(outline.ellipse), outline.shape.is_bright
    edge_picture = EdgePicture(image=image, lens=lens)
    edges = measure_ellipse(edge_picture, start, is_bright=is_bright, reach_px=5.0, effort=THOROUGHLY)
    if edges is None:
        raise RuntimeError("the edge of the disc was not found")
    x, y = edges.ellipse.centre_px.tolist()
    shape, lines, fitted = (Panel(image, (x, y)) for _ in range(3))
    shape.dots(outline.shape.contour[:, 0] / view.scale, YELLOW)
    shape.loop(start.rim(90).points_px, RED)
    rim = start.rim(36)
    lines.lines(rim.points_px - 5.0 * rim.outward, rim.points_px + 5.0 * rim.outward, YELLOW)
    fitted.loop(edges.ellipse.rim(180).points_px, RED)
    fitted.dots(_ends(edges.ellipse), BLUE)
    save(path, shape, lines, fitted)


def make_round_pictures(folder: Path) -> None:
    """Make both pictures."""
    ball_picture(folder / "measuring-ball.jpg")
    disc_picture(folder / "measuring-disc.jpg")


def _scene(target: Target, *, floor: bool) -> Scene:
    backdrop = FloorBackdrop(ground=Ground.WOOD, bgr=(80, 120, 165)) if floor else PlainBackdrop(bgr=(90, 84, 80))
    return Scene(camera=draw.CAMERA, target=target, seed=7, backdrop=backdrop)


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


def _ends(ellipse: Ellipse) -> Points:
    """Return both ends of the larger axis."""
    half_px, _, along = ellipse.axes()
    return ellipse.centre_px + half_px * np.outer((1.0, -1.0), along)


def save(path: Path, *panels: Panel) -> None:
    """Write panels beside each other."""
    gap = np.full((PANEL_PX * ENLARGED, 8, 3), 255, np.uint8)
    row = [each for panel in panels for each in (panel.pixels, gap)][:-1]
    cv2.imwrite(str(path), np.concatenate(row, axis=1), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    make_round_pictures(Path(__file__).parent)
