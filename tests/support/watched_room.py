"""A room in front of a fixed camera, day and night, with exact truth of how the camera was turned, zoomed and focused.

The room is a flat canvas at two pixels for each of the camera's, painted from a seed: furniture, pictures, writing,
bookcases. Light comes from a window whose patch wanders over the room, from a lamp in the evening, and from the street
at night, but from 1:00 to 5:00, when it is as good as dark. People stand and walk about. The camera has a point spread,
automatic exposure, noise and JPEG.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel

WIDTH_PX, HEIGHT_PX = 640, 480
FOCAL_PX = 540.0
LENS = CameraModel.with_focal_length(FOCAL_PX, WIDTH_PX, HEIGHT_PX)

# The minutes of the day between which it is dark.
DARK_FROM, LIGHT_AGAIN_AT = 60, 300

CANVAS_SCALE = 2
MARGIN_PX = 120


@dataclass(slots=True)
class Pose:
    """How the camera is turned (pan to the right, tilt up, roll with its right side down), zoomed and out of focus."""

    pan_deg: float = 0.0
    tilt_deg: float = 0.0
    roll_deg: float = 0.0
    zoom: float = 0.0
    blur_px: float = 0.0
    """Diameter of the disc that a point becomes, beyond a sharp picture."""


@dataclass(slots=True)
class WatchedRoom:
    """A room painted from a seed, or a picture."""

    seed: int
    painting: NDArray[np.uint8] | None = None
    canvas: NDArray[np.float32] = field(init=False)
    rng: np.random.Generator = field(init=False)
    people: list[tuple[float, float, float, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Paint it."""
        self.rng = np.random.default_rng((self.seed, 7))
        size = CANVAS_SCALE * (HEIGHT_PX + 2 * MARGIN_PX), CANVAS_SCALE * (WIDTH_PX + 2 * MARGIN_PX)
        if self.painting is not None:
            painted = cv2.resize(self.painting, size[::-1], interpolation=cv2.INTER_CUBIC)
        else:
            painted = _paint(self.rng, size)
        self.canvas = cv2.cvtColor(painted, cv2.COLOR_BGR2GRAY).astype(np.float32)
        self.people = [(*self.rng.uniform(0, 1, 3), int(self.rng.integers(1 << 30))) for _ in range(3)]

    def pictures(self, minute: float, pose: Pose | None = None, count: int = 4) -> list[NDArray[np.uint8]]:
        """Return some pictures of a moment of the day."""
        pose = pose or Pose()
        scene = self._lit(minute)
        self._add_people(scene, minute)
        view = self._seen(scene, pose)
        return [self._exposed(view, minute, pose) for _ in range(count)]

    def _lit(self, minute: float) -> NDArray[np.float32]:
        """Return the canvas in the light of a minute.

        The sun shines from 6:00 to 20:00, a lamp from 18:00 to 23:00, and the street's lights but from 1:00 to 5:00.
        """
        height, width = self.canvas.shape[:2]
        y, x = np.mgrid[0 : height // 8, 0 : width // 8].astype(np.float32) / np.float32(height // 8)
        sun = max(0.0, math.sin(math.pi * (minute / 60 - 6) / 14)) if 6 <= minute / 60 <= 20 else 0.0
        cloud = 0.75 + 0.25 * math.sin(0.11 * minute + self.seed) * math.sin(0.023 * minute)
        light = np.full_like(x, (0.0001 if is_dark(minute) else 0.012) + 0.55 * sun * cloud)
        light += 0.25 * sun * cloud * (1 - x / 2)  # from the window at the left
        if 18 <= minute / 60 <= 23:
            light += 0.45 / (1 + 3 * ((x - 1.2) ** 2 + (y - 0.1) ** 2))
        lit = cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)
        if sun > 0.15:  # a patch of sunlight with a sharp edge, crossed by the bars of the window, wanders
            left = width * (1.0 - (minute / 60 - 6) / 14) - 200
            corners = np.array([[left, 300], [left + 420, 360], [left + 300, 1000], [left - 120, 940]])
            patch = np.zeros((height, width), np.float32)
            cv2.fillConvexPoly(patch, corners.astype(np.int32), 0.5 * sun * cloud)
            cv2.line(patch, (int(left + 200), 300), (int(left + 90), 1000), 0, 14)
            lit += cv2.GaussianBlur(patch, (0, 0), 2.0)
        return self.canvas * lit

    def _seen(self, scene: NDArray[np.float32], pose: Pose) -> NDArray[np.float32]:
        """Return what the lens makes of the scene, at its own resolution, in light."""
        pan, tilt, roll = (math.radians(each) for each in (pose.pan_deg, pose.tilt_deg, pose.roll_deg))
        rotation = cv2.Rodrigues(np.array([-tilt, -pan, -roll]))[0]
        scale = float(CANVAS_SCALE)
        middle = [(each + 2 * MARGIN_PX) * scale / 2 - 0.5 for each in (WIDTH_PX, HEIGHT_PX)]
        canvas = np.array([[FOCAL_PX * scale, 0, middle[0]], [0, FOCAL_PX * scale, middle[1]], [0, 0, 1]])
        focal = FOCAL_PX * scale * (1 + pose.zoom)
        camera = np.array([[focal, 0, WIDTH_PX - 0.5], [0, focal, HEIGHT_PX - 0.5], [0, 0, 1]])
        size = (2 * WIDTH_PX, 2 * HEIGHT_PX)
        double = cv2.warpPerspective(scene, camera @ rotation @ np.linalg.inv(canvas), size, flags=cv2.INTER_LINEAR)
        double = cv2.GaussianBlur(double, (0, 0), 1.1)  # a sharp lens: a standard deviation of 0.55 px
        if pose.blur_px:
            double = cv2.filter2D(double, -1, _disc(2 * pose.blur_px))
        return cv2.resize(double, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)

    def _add_people(self, scene: NDArray[np.float32], minute: float) -> None:
        """Draw who is about: from 7:00 to 23:00 one to three people, who stand for some minutes and then walk on."""
        if not 7 <= minute / 60 <= 23:
            return
        level = float(scene.mean())
        for number, (phase, speed, tone, seed) in enumerate(self.people):
            stop = int(minute / (3 + 9 * speed) + 10 * phase)
            rng = np.random.default_rng((seed, stop))
            if rng.random() < 0.4 + 0.2 * number:
                continue
            x, height = MARGIN_PX + rng.uniform(0, WIDTH_PX), int(CANVAS_SCALE * rng.uniform(200, 380))
            width = height // 3
            rough = rng.uniform(0.3, 1.0, (24, 12)).astype(np.float32) * np.float32(level * (0.3 + tone))
            person = cv2.resize(rough, (width, height), interpolation=cv2.INTER_CUBIC)
            shape = np.zeros(person.shape[:2], np.float32)
            cv2.ellipse(shape, (width // 2, height // 2), (width // 2 - 2, height // 2 - 2), 0, 0, 360, 1.0, -1)
            # Feet at the lower rim of the picture; as wide as the margin is, all of it is on the canvas.
            left, top = max(0, int(CANVAS_SCALE * x) - width // 2), CANVAS_SCALE * (MARGIN_PX + HEIGHT_PX) - height
            part = scene[top : top + height, left : left + width]
            shape, person = (each[:, : part.shape[1]] for each in (shape, person))
            part *= 1 - shape
            part += shape * person

    def _exposed(self, view: NDArray[np.float32], minute: float, pose: Pose) -> NDArray[np.uint8]:
        """Return a picture: exposure as far as the camera can, noise that grows with its gain, sRGB, and JPEG."""
        gain = min(110.0 / max(float(view.mean()), 0.1), 18.0) * (1 + 0.04 * math.sin(0.7 * minute))
        light = view * gain / 255
        noise = self.rng.standard_normal(view.shape).astype(np.float32)
        light = light + noise * np.sqrt(1e-6 * gain**2 + 2e-5 * gain * np.maximum(light, 0)).astype(np.float32)
        levels = 255 * np.clip(light, 0, 1) ** (1 / 1.8)
        coded = cv2.imencode(".jpg", levels.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)  # three alike: it is looked at in grey


def is_dark(minute: float) -> bool:
    """Return whether a camera sees nothing at a minute of the day."""
    return DARK_FROM <= minute < LIGHT_AGAIN_AT


def _disc(diameter: float) -> NDArray[np.float32]:
    """Return the point spread of a lens out of focus, drawn finely."""
    half = math.ceil(diameter / 2)
    fine = 16
    axis = (np.arange((2 * half + 1) * fine) + 0.5) / fine - half - 0.5
    inside = (np.hypot(*np.meshgrid(axis, axis)) <= diameter / 2).astype(np.float32)
    kernel = inside.reshape(2 * half + 1, fine, 2 * half + 1, fine).mean(axis=(1, 3))
    return np.asarray(kernel / kernel.sum(), np.float32)


def _paint(rng: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float32]:
    height, width = size
    canvas = np.full((height, width, 3), rng.uniform(120, 190), np.uint8)
    cv2.rectangle(canvas, (0, int(0.72 * height)), (width, height), tuple(rng.uniform(70, 130, 3)), -1)
    for _ in range(int(rng.integers(14, 26))):  # furniture and pictures, with things in them
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        w, h = rng.uniform(0.05, 0.25, 2) * width
        cv2.rectangle(canvas, (int(x), int(y)), (int(x + w), int(y + h)), tuple(rng.uniform(30, 230, 3)), -1)
        match rng.integers(4):
            case 0:  # books
                for left in np.arange(x, x + w, rng.uniform(10, 26)):
                    right = left + rng.uniform(6, 20)
                    cv2.rectangle(
                        canvas,
                        (int(left), int(y + rng.uniform(0, h / 3))),
                        (int(right), int(y + h)),
                        tuple(rng.uniform(20, 240, 3)),
                        -1,
                    )
            case 1:  # writing
                for row in np.arange(y + 24, y + h, 34):
                    text = "".join(chr(each) for each in rng.integers(97, 123, 12))
                    cv2.putText(
                        canvas, text, (int(x), int(row)), cv2.FONT_HERSHEY_SIMPLEX, 0.9, tuple(rng.uniform(0, 60, 3)), 2
                    )
            case 2:  # a picture
                rough = rng.uniform(20, 235, (8, 8, 3)).astype(np.uint8)
                part = canvas[int(y) : int(y + h), int(x) : int(x + w)]
                part[:] = cv2.resize(rough, (int(x + w) - int(x), int(y + h) - int(y)), interpolation=cv2.INTER_CUBIC)[
                    : part.shape[0], : part.shape[1]
                ]
            case _:
                for _ in range(6):
                    centre = int(x + rng.uniform(0, w)), int(y + rng.uniform(0, h))
                    cv2.circle(canvas, centre, int(rng.uniform(6, 40)), tuple(rng.uniform(20, 240, 3)), -1)
    fine = rng.standard_normal((height // 4, width // 4, 1)).astype(np.float32)
    grain = 3 * cv2.resize(fine, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]
    return np.clip(canvas + grain, 5, 250).astype(np.uint8)
