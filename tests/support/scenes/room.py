"""Rooms without a target: furniture, shelves, tiles, windows, cloth and cubes.

Things are real rectangles and boxes in space, seen through a pinhole. None of the rectangles has an aspect near that of
a sheet of paper, and no disc is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from support.scenes.backdrop import SHEETLIKE_ASPECTS, TARGET_HUES, TARGET_SATURATION, KeepOut
from support.scenes.target import Colour
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]
Floats = NDArray[np.float64]

FINER = 2
FRACTION_BITS = 4
FOCAL_WIDTHS = 0.94
"""Focal length of the room's pinhole, in widths of the picture."""

WOODS: tuple[Colour, ...] = ((70, 105, 150), (95, 140, 185), (50, 70, 105), (130, 165, 195))
GREYS: tuple[Colour, ...] = ((205, 210, 212), (160, 165, 168), (110, 112, 115), (60, 60, 62), (30, 30, 32))
SMOOTH, GRAIN, SPECKLE, CLOTH = range(4)
"""What the surface of a thing is like."""

AMPLITUDES = (0.015, 0.10, 0.18, 0.12)


class RoomBackdrop(Struct, frozen=True, kw_only=True):
    """A room.

    Attributes:
        things: How many pieces of furniture and the like are in it.
        like_target: The share of the things of a tennis ball's colour that keep it.
    """

    things: int = 9
    like_target: float = 0.05

    @property
    def avoids_target(self) -> bool:
        """It does not."""
        return False

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light; it is the same with and without a target."""
        view = _View(width_px, height_px, np.random.default_rng((seed, 90)), self.like_target)
        _walls(view)
        kinds = (_cupboard, _shelf, _tiles, _window, _poster, _chair, _cube, _cube, _keyboard, _cloth, _cushion)
        for kind in view.rng.integers(0, len(kinds), self.things):
            kinds[kind](view)
        return _finished(view)


@dataclass(slots=True)
class _View:
    """What has been drawn so far: colours at a finer scale, and the kind of surface."""

    width_px: int
    height_px: int
    rng: np.random.Generator
    like_target: float
    colours: NDArray[np.uint8] = field(init=False)
    surfaces: NDArray[np.uint8] = field(init=False)

    def __post_init__(self) -> None:
        self.colours = np.zeros((self.height_px * FINER, self.width_px * FINER, 3), np.uint8)
        self.surfaces = np.zeros(self.colours.shape[:2], np.uint8)

    def draw(self, polygon: Floats, bgr: Colour, surface: int = SMOOTH) -> None:
        """Draw a polygon in pixels."""
        fixed = np.rint(((np.clip(polygon, -3e3, 3e3) + 0.5) * FINER - 0.5) * (1 << FRACTION_BITS))
        points = [fixed.astype(np.int32).reshape(-1, 1, 2)]
        cv2.fillPoly(self.colours, points, bgr, lineType=cv2.LINE_AA, shift=FRACTION_BITS)
        cv2.fillPoly(self.surfaces, points, surface, shift=FRACTION_BITS)

    def frame(self, nearest_m: float = 0.5, tilt_rad: float = 1.1) -> _Frame:
        """Return a place for a thing: where it is and how it is turned."""
        depth = float(np.exp(self.rng.uniform(math.log(nearest_m), math.log(5.0))))
        x, y = self.rng.uniform(-0.55, 0.55) * depth, self.rng.uniform(-0.4, 0.4) * depth
        yaw, roll = self.rng.uniform(-tilt_rad, tilt_rad), self.rng.choice([0.0, 0.0, self.rng.uniform(-0.6, 0.6)])
        pitch = self.rng.choice([0.0, self.rng.uniform(-0.7, 0.7)])
        axes = _about(1, yaw) @ _about(0, pitch) @ _about(2, roll)
        return _Frame(np.array((x, y, depth)), axes, FOCAL_WIDTHS * self.width_px, (self.width_px, self.height_px))

    def colour(self) -> Colour:
        """Return a colour: grey, wood or any."""
        kind = self.rng.random()
        if kind < 0.3:
            return self.pick(GREYS)
        if kind < 0.5:
            return self.pick(WOODS)
        blue, green, red = (int(v) for v in self.rng.integers(8, 248, 3))
        keeps = self.rng.random() < self.like_target
        return (green, blue, red) if not keeps and _is_like_target((blue, green, red)) else (blue, green, red)

    def pick(self, colours: tuple[Colour, ...]) -> Colour:
        """Return one of some colours, a little changed."""
        chosen, change = colours[int(self.rng.integers(len(colours)))], int(self.rng.integers(-14, 15))
        blue, green, red = (int(np.clip(part + change, 3, 252)) for part in chosen)
        return blue, green, red

    def sides(self, long_m: float) -> tuple[float, float]:
        """Return the sides of a rectangle that is none of paper, either of them the longer."""
        low, high = SHEETLIKE_ASPECTS
        aspect = self.rng.uniform(1.0, low) if self.rng.random() < 0.35 else self.rng.uniform(high, 4.0)
        sides = (long_m, long_m / float(aspect))
        return sides if self.rng.random() < 0.5 else (sides[1], sides[0])


class _Frame(Struct, frozen=True):
    """A thing's own axes in the camera's."""

    middle: Floats
    axes: Floats
    focal_px: float
    size_px: tuple[int, int]

    def seen(self, points_m: Floats) -> Floats:
        """Return where points of the thing's own frame appear, in pixels."""
        points = np.atleast_2d(points_m) @ self.axes.T + self.middle
        depth = np.maximum(points[:, 2:], 0.05)
        middle = np.array(((self.size_px[0] - 1) / 2, (self.size_px[1] - 1) / 2))
        return np.asarray(points[:, :2] / depth * self.focal_px + middle)

    def box(self, left: float, top: float, right: float, bottom: float, z: float = 0.0) -> Floats:
        """Return where an upright rectangle appears."""
        corners = ((left, top), (right, top), (right, bottom), (left, bottom))
        return self.seen(np.array([(x, y, z) for x, y in corners]))


def _walls(view: _View) -> None:
    """Draw a wall, a floor below it, and perhaps a corner of the room."""
    w, h, rng = view.width_px, view.height_px, view.rng
    horizon = rng.uniform(0.45, 1.05) * h
    wall = view.pick(GREYS[:3]) if rng.random() < 0.6 else view.colour()
    view.draw(np.array(((-9, -9), (w + 9, -9), (w + 9, h + 9), (-9, h + 9))), wall, int(rng.choice([SMOOTH, SPECKLE])))
    if rng.random() < 0.4:
        corner, lean = rng.uniform(0.1, 0.9) * w, rng.uniform(-30, 30)
        darker = tuple(int(part * 0.8) for part in wall)
        side = np.array(((corner, -9), (w + 9, -9), (w + 9, horizon + 60), (corner + lean, horizon)))
        view.draw(side, (darker[0], darker[1], darker[2]))
    floor = view.pick(WOODS + GREYS)
    fall = rng.uniform(-0.1, 0.1) * h
    ground = np.array(((-9, horizon - fall), (w + 9, horizon + fall), (w + 9, 2 * h), (-9, 2 * h)))
    view.draw(ground, floor, int(rng.choice([GRAIN, SPECKLE, SPECKLE])))


def _cupboard(view: _View) -> None:
    """Draw a cupboard: a body with doors that have handles."""
    at, (w, h) = view.frame(1.2, 0.9), view.sides(float(view.rng.uniform(0.5, 2.0)))
    body = view.colour()
    view.draw(at.box(-w / 2, -h / 2, w / 2, h / 2), body, GRAIN)
    line = tuple(int(part * 0.55) for part in body)
    count, gap = int(view.rng.integers(1, 4)), 0.006
    # Doors are much taller than wide or much wider than tall, never like paper.
    is_tall = h / (w / count) > SHEETLIKE_ASPECTS[1]
    for k in range(count if is_tall else 0):
        left, right = -w / 2 + k * w / count, -w / 2 + (k + 1) * w / count
        view.draw(at.box(left, -h / 2, left + gap, h / 2), (line[0], line[1], line[2]))
        view.draw(at.box(right - 0.06, -0.06, right - 0.04, 0.08), view.pick(GREYS))


def _shelf(view: _View) -> None:
    """Draw a board with the backs of books on it."""
    at, rng = view.frame(0.8), view.rng
    x, end, height = -0.5, rng.uniform(0.0, 0.5), rng.uniform(0.2, 0.3)
    view.draw(at.box(-0.55, -height - 0.08, 0.55, height * 0.1), view.pick(GREYS[2:]))
    while x < end:
        thick, tall = rng.uniform(0.015, 0.06), height * rng.uniform(0.75, 1.05)
        view.draw(at.box(x, -tall, x + thick, 0.0), view.colour())
        if rng.random() < 0.5:
            view.draw(at.box(x + 0.2 * thick, -0.8 * tall, x + 0.8 * thick, -0.35 * tall), view.pick(GREYS))
        x += thick + 0.001
    view.draw(at.box(-0.6, 0.0, 0.6, 0.025), view.pick(WOODS), GRAIN)


def _tiles(view: _View) -> None:
    """Draw square or narrow tiles with joints."""
    at, rng = view.frame(0.7), view.rng
    side, stretch = rng.uniform(0.05, 0.2), float(rng.choice([1.0, 1.0, 2.0, 3.0]))
    across, down = int(rng.integers(3, 9)), int(rng.integers(3, 9))
    while paperlike(across * stretch, down):
        down += 1
    view.draw(at.box(0, 0, across * side * stretch, down * side), view.pick(GREYS))
    first, second = view.colour(), view.colour()
    is_chequered, joint = rng.random() < 0.4, side * rng.uniform(0.02, 0.1)
    for i in range(across):
        for j in range(down):
            colour = second if is_chequered and (i + j) % 2 else first
            left, top = i * side * stretch, j * side
            view.draw(at.box(left + joint, top + joint, left + side * stretch - joint, top + side - joint), colour)


def _window(view: _View) -> None:
    """Draw a bright window with a frame and bars."""
    at, (w, h), rng = view.frame(1.5, 0.8), view.sides(float(view.rng.uniform(0.6, 1.8))), view.rng
    edge = 0.05 if not paperlike(w + 0.1, h + 0.1) else 0.005
    view.draw(at.box(-w / 2 - edge, -h / 2 - edge, w / 2 + edge, h / 2 + edge), view.pick(GREYS[:2]))
    view.draw(at.box(-w / 2, -h / 2, w / 2, h / 2), (255, 252, 246) if rng.random() < 0.5 else view.pick(GREYS))
    for k in range(1, int(rng.integers(1, 4))):
        x = -w / 2 + w * k / 6
        if paperlike(w * (1 - k / 6), h) or paperlike(w / 6, h):
            break
        view.draw(at.box(x - 0.015, -h / 2, x + 0.015, h / 2), view.pick(GREYS[:2]))


def _poster(view: _View) -> None:
    """Draw something with a border and with blocks of text and colour on it."""
    at, (w, h), rng = view.frame(0.6), view.sides(float(view.rng.uniform(0.2, 1.0))), view.rng
    view.draw(at.box(-w / 2, -h / 2, w / 2, h / 2), view.colour())
    if rng.random() < 0.6:
        share = rng.uniform(0.85, 0.97)
        inner = (w * share, h - w * (1 - share)) if w < h else (w - h * (1 - share), h * share)
        if not paperlike(*inner):
            view.draw(at.box(-inner[0] / 2, -inner[1] / 2, inner[0] / 2, inner[1] / 2), view.colour())
    for _ in range(int(rng.integers(0, 14))):
        x, y, long = rng.uniform(-0.4, 0.1) * w, rng.uniform(-0.4, 0.4) * h, rng.uniform(0.1, 0.3) * w
        view.draw(at.box(x, y, x + long, y + 0.025 * h), view.colour())


def _chair(view: _View) -> None:
    """Draw legs, a seat and a back of bars, with nothing but narrow gaps between them."""
    at, rng, colour = view.frame(1.0, 0.8), view.rng, view.colour()
    surface = int(rng.choice([SMOOTH, GRAIN]))
    for x in (-0.22, 0.2):
        view.draw(at.box(x, 0.0, x + 0.035, 0.45), colour, surface)
        view.draw(at.box(x, -0.5, x + 0.03, 0.0), colour, surface)
    for y in np.linspace(-0.48, -0.15, int(rng.integers(3, 6))):
        view.draw(at.box(-0.22, y, 0.23, y + 0.05), colour, surface)
    seat = np.array(((-0.25, 0, -0.2), (0.25, 0, -0.2), (0.22, 0, 0.2), (-0.22, 0, 0.2)))
    view.draw(at.seen(seat), view.colour(), surface)


def _cube(view: _View) -> None:
    """Draw a cube or a box with soft corners: of cloth, of wood, of cardboard."""
    at, rng = view.frame(0.4, 0.8), view.rng
    half, is_cloth = rng.uniform(0.05, 0.25), rng.random() < 0.6
    sizes = half * (rng.uniform(0.92, 1.08, 3) if is_cloth else rng.uniform(0.9, 1.1, 3))
    colour, lamp = view.colour(), np.array((rng.uniform(-1, 1), -1.0, rng.uniform(-1, -0.2)))
    rounding = rng.uniform(0.04, 0.16) if is_cloth else rng.uniform(0.0, 0.03)
    surface = CLOTH if is_cloth else int(rng.choice([SMOOTH, GRAIN]))
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = at.axes[:, axis] * sign
            if float(normal @ (at.middle + normal * sizes[axis])) < 0:
                face = _face(rng, axis, sign, sizes, rounding, 0.012 if is_cloth else 0.0)
                light = 0.45 + 0.55 * max(0.0, float(normal @ lamp) / float(np.linalg.norm(lamp)))
                shaded = tuple(int(part * light) for part in colour)
                view.draw(at.seen(face), (shaded[0], shaded[1], shaded[2]), surface)


def _face(rng: np.random.Generator, axis: int, sign: float, half: Floats, rounding: float, waves: float) -> Floats:
    """Return the outline of a box's face: a square with round corners and sides that are not quite straight."""
    angles = np.linspace(0, 2 * math.pi, 96, endpoint=False)
    square = np.column_stack((np.cos(angles), np.sin(angles)))
    square /= np.abs(square).max(axis=1, keepdims=True)
    inner = np.clip(square, -1 + rounding, 1 - rounding)
    out = square - inner
    length = np.linalg.norm(out, axis=1, keepdims=True)
    rounded = inner + out / np.maximum(length, 1e-9) * np.minimum(length, rounding)
    wobble = sum(rng.normal(0, waves) * np.cos(k * angles + rng.uniform(0, 6.28)) for k in range(2, 9))
    first, second = ((1, 2), (0, 2), (0, 1))[axis]
    face = np.zeros((len(angles), 3))
    face[:, axis] = sign * half[axis]
    face[:, (first, second)] = rounded * (1 + np.asarray(wobble).reshape(-1, 1)) * half[[first, second]]
    return face


def _keyboard(view: _View) -> None:
    """Draw rows of small keys on a dark body."""
    at, rng = view.frame(0.5), view.rng
    columns, rows, key = int(rng.integers(10, 18)), int(rng.integers(3, 6)), 0.019
    body, cap = view.pick(GREYS), view.pick(GREYS)
    view.draw(at.box(-0.01, -0.01, columns * key + 0.01, rows * key + 0.01), body)
    for i in range(columns):
        for j in range(rows):
            view.draw(at.box(i * key + 0.002, j * key + 0.002, (i + 1) * key - 0.002, (j + 1) * key - 0.002), cap)


def _cloth(view: _View) -> None:
    """Draw a curtain or a coat: a shape with wavy sides and stripes of folds."""
    at, rng, colour = view.frame(0.8, 0.5), view.rng, view.colour()
    w, h, folds = rng.uniform(0.3, 0.9), rng.uniform(0.7, 1.8), int(rng.integers(3, 9))
    down = np.linspace(-h / 2, h / 2, 24)
    for k in range(folds):
        light = rng.uniform(0.6, 1.0)
        shaded = tuple(int(part * light) for part in colour)
        left, right = ((k + part) * w / folds - w / 2 for part in (0.0, 1.05))
        sway = 0.03 * np.sin(down * rng.uniform(2, 7) + rng.uniform(0, 6))
        sides = [np.column_stack((x + sway, down, 0 * down)) for x in (left, right)]
        view.draw(at.seen(np.vstack((sides[0], sides[1][::-1]))), (shaded[0], shaded[1], shaded[2]), CLOTH)


def _cushion(view: _View) -> None:
    """Draw what is rounded but no disc from any side: a cushion, an egg shape, a half-moon."""
    at, rng, radius = view.frame(0.5, 0.6), view.rng, float(view.rng.uniform(0.03, 0.25))
    angles = np.linspace(0, 2 * math.pi, 96, endpoint=False)
    cosine, sine = np.cos(angles), np.sin(angles)
    kind = rng.random()
    if kind < 0.5:
        power = 2 / rng.uniform(3.0, 6.0)
        x, y = (np.sign(part) * np.abs(part) ** power for part in (cosine, sine))
    elif kind < 0.75:
        x, y = cosine, sine * (1 + rng.uniform(0.25, 0.5) * cosine)
    else:
        x, y = np.maximum(cosine, -rng.uniform(0.0, 0.6)), sine
    outline = np.column_stack((x, y * rng.uniform(0.6, 1.0), 0 * x)) * radius
    view.draw(at.seen(outline), view.colour(), int(rng.choice([SMOOTH, CLOTH])))


def _finished(view: _View) -> Plane:
    """Return the light: the colours with the textures of their surfaces, in uneven light with a shadow."""
    w, h, rng = view.width_px, view.height_px, view.rng
    table = decode_srgb(np.arange(256))
    mean = cv2.resize(np.asarray(table[view.colours], np.float32), (w, h), interpolation=cv2.INTER_AREA)
    kinds = view.surfaces[::FINER, ::FINER]
    fine = rng.standard_normal((h, w), dtype=np.float32)
    soft = cv2.GaussianBlur(fine, (0, 0), 1.2) * 4
    along = cv2.GaussianBlur(fine, (0, 0), sigmaX=9, sigmaY=0.8) * 8
    folds = cv2.resize(rng.standard_normal((h // 12, w // 12), dtype=np.float32), (w, h), interpolation=cv2.INTER_CUBIC)
    texture = np.choose(kinds, (fine, along, 0.7 * soft + 0.5 * fine, 0.8 * folds + 0.4 * soft))
    strength = np.array(AMPLITUDES, np.float32)[kinds] * np.float32(rng.uniform(0.4, 1.6))
    x, y = np.linspace(-1, 1, w)[None, :], np.linspace(-1, 1, h)[:, None]
    lamp = 1 + rng.uniform(-0.35, 0.35) * x + rng.uniform(-0.35, 0.35) * y
    if rng.random() < 0.4:
        angle, place = rng.uniform(0, 2 * math.pi), rng.uniform(-0.6, 0.6)
        deep = (x * math.cos(angle) + y * math.sin(angle) - place) / rng.uniform(0.02, 0.3)
        lamp = lamp * (1 - rng.uniform(0.2, 0.7) * np.clip(deep + 0.5, 0, 1))
    shade = np.clip(1 + strength * texture, 0.05, None) * lamp.astype(np.float32)
    return np.asarray(np.clip(mean * shade[:, :, None], 0, None), np.float32)


def _about(axis: int, angle_rad: float) -> Floats:
    first, second = ((1, 2), (2, 0), (0, 1))[axis]
    turn = np.eye(3)
    turn[first, first] = turn[second, second] = math.cos(angle_rad)
    turn[first, second], turn[second, first] = -math.sin(angle_rad), math.sin(angle_rad)
    return turn


def paperlike(width: float, height: float) -> bool:
    """Return whether a rectangle has about the aspect of letter or A4 paper."""
    low, high = SHEETLIKE_ASPECTS
    return low < max(width, height) / min(width, height) < high


def _is_like_target(bgr: Colour) -> bool:
    hue, saturation, _ = cv2.cvtColor(np.array([[bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0]
    return bool(TARGET_HUES[0] <= hue <= TARGET_HUES[1] and saturation >= TARGET_SATURATION)
