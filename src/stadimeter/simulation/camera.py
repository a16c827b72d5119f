"""A camera on the simulated robot.

Its pictures show a room with four walls and a tiled floor, a ball with its shadow, and noise.

The room is drawn once as a panorama, a picture on a cylinder around the camera, from which every view is cut. So
turning shows as it should, driving does not: the walls keep their distance, as a backdrop.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Coordinate, Duration, Frequency
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import CaptureTimeoutError, ConfigError, DeviceClosedError
from stadimeter.simulation.world import Faults, World, shared_world

# A ball through a pinhole: its exact outline, and its picture.
#
# The rays that touch a ball form a cone, and the picture plane cuts the cone in an ellipse. With the ball's centre at
# ``c`` and its radius ``r``, a ray ``d`` hits the ball if ``(d·c)² >= |d|² (|c|² - r²)``; the dual of that conic is
# ``c cᵀ - r² I``, from which its extent follows (R. Hartley and A. Zisserman, "Multiple View Geometry", section 8.3).
# Seen along the plane through the optical axis and the ball's centre, the ellipse is longest; across it is ``r /
# sqrt(z² - r²)`` per unit of depth, which is what similar triangles want.
#
# In a picture each pixel's ray is intersected with the sphere, and the edge is anti-aliased exactly.

Vector = tuple[float, float, float]
Plane = NDArray[np.float32]

# Nearer to the axis than this, rounding leaves nothing of the direction, and the outline is a circle anyway.
NO_DIRECTION_M = 1e-12

# The yellowish green of a tennis ball. Shading scales all three alike, so hue and saturation hold on the dark side.
BALL_BGR = (52, 232, 190)

# The direction of the light, in the camera frame: from above, from the left and from behind the camera.
LIGHT = (-0.37, -0.83, -0.42)

MIN_SHADE = 0.42

# A ball of fewer samples across is sampled more finely.
FINE_PX = 96

SHADOW_DEPTH = 0.5


class Silhouette(Struct, frozen=True, kw_only=True):
    """The ellipse that a ball fills in a picture. Pixel coordinates have (0, 0) at the centre of the top left pixel."""

    centre_px: tuple[float, float]  # its centre, which lies a little further out than where the ball's centre is seen
    # Its half axis across the direction from the optical centre, in horizontal and vertical pixels.
    half_across_px: tuple[float, float]
    half_along_px: tuple[float, float]  # its half axis along that direction, likewise
    along: tuple[float, float]  # that direction as a unit vector, x right and y down
    extent_px: tuple[float, float, float, float]  # its bounding box: left, top, right, bottom

    def outline_px(self, cos_sin: Points, scale: float = 1.0) -> Points:
        """Return points on the ellipse, or one larger by a scale, from points on the unit circle, ``(n, 2)`` each."""
        (ax, ay), (bx, by), (ux, uy) = self.half_along_px, self.half_across_px, self.along
        axes = np.array(((ux * ax * scale, uy * ay * scale), (-uy * bx * scale, ux * by * scale)))
        outline: Points = cos_sin @ axes + self.centre_px
        return outline


def silhouette(model: CameraModel, centre_m: Vector, radius_m: float) -> Silhouette | None:
    """Return the ellipse that a ball fills in a picture, perhaps outside it; its centre is x right, y down, z forward.

    None if some of the ball is not in front of the camera.
    """
    x, y, z = centre_m
    if z <= radius_m:
        return None
    power = z * z - radius_m * radius_m
    off_axis = math.hypot(x, y)
    across = radius_m / math.sqrt(power)
    along = radius_m * math.sqrt(off_axis * off_axis + power) / power
    left, right = _extent(x, z, radius_m)
    top, bottom = _extent(y, z, radius_m)
    return Silhouette(
        centre_px=(model.cx_px + model.fx_px * x * z / power, model.cy_px + model.fy_px * y * z / power),
        half_across_px=(model.fx_px * across, model.fy_px * across),
        half_along_px=(model.fx_px * along, model.fy_px * along),
        along=(x / off_axis, y / off_axis) if off_axis > NO_DIRECTION_M else (1.0, 0.0),
        extent_px=(
            model.cx_px + model.fx_px * left,
            model.cy_px + model.fy_px * top,
            model.cx_px + model.fx_px * right,
            model.cy_px + model.fy_px * bottom,
        ),
    )


def _extent(sideways_m: float, z_m: float, radius_m: float) -> tuple[float, float]:
    power = z_m * z_m - radius_m * radius_m
    middle = sideways_m * z_m / power
    half = radius_m * math.sqrt(sideways_m * sideways_m + power) / power
    return (middle - half, middle + half)


def hits(direction: tuple[float, float], centre_m: Vector, radius_m: float) -> bool:
    """Check whether a ray, x and y per unit of depth, hits a ball in the camera frame, the limb included."""
    (u, v), (x, y, z) = direction, centre_m
    ahead = u * x + v * y + z
    return ahead > 0 and ahead * ahead >= (u * u + v * v + 1) * (x * x + y * y + z * z - radius_m * radius_m)


class _Patch(Struct, frozen=True, kw_only=True):
    """A part of a picture, in whole pixels, right and bottom excluded."""

    left: int
    top: int
    right: int
    bottom: int

    def of(self, image: Image) -> Image:
        return image[self.top : self.bottom, self.left : self.right]

    def rays(self, model: CameraModel, finer: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x and y per unit of depth of its columns and rows, with ``finer`` of them in a pixel."""
        columns = self.left + (np.arange((self.right - self.left) * finer) + 0.5) / finer - 0.5
        rows = self.top + (np.arange((self.bottom - self.top) * finer) + 0.5) / finer - 0.5
        return (columns - model.cx_px) / model.fx_px, (rows - model.cy_px) / model.fy_px


def _patch(model: CameraModel, extent_px: tuple[float, float, float, float]) -> _Patch | None:
    left, top = max(0, math.floor(extent_px[0])), max(0, math.floor(extent_px[1]))
    right, bottom = min(model.width_px, math.ceil(extent_px[2]) + 1), min(model.height_px, math.ceil(extent_px[3]) + 1)
    return _Patch(left=left, top=top, right=right, bottom=bottom) if left < right and top < bottom else None


def paint_ball(image: Image, model: CameraModel, centre_m: Vector, radius_m: float) -> None:
    """Paint a ball into a picture; its centre is in the camera frame: x right, y down, z forward."""
    if centre_m[2] <= -radius_m:
        return
    seen = silhouette(model, centre_m, radius_m)
    extent_px = seen.extent_px if seen else (0.0, 0.0, float(model.width_px), float(model.height_px))
    patch = _patch(model, extent_px)
    if patch is None:
        return
    across_px = max(extent_px[2] - extent_px[0], extent_px[3] - extent_px[1])
    finer = max(1, min(8, math.ceil(FINE_PX / across_px)))
    middle_px = seen.centre_px if seen else (model.cx_px, model.cy_px)
    cover, shade = _cast(patch.rays(model, finer), model.direction(*middle_px), centre_m, radius_m)
    size = (patch.right - patch.left, patch.bottom - patch.top)
    layers = cv2.resize(cv2.merge((cover, cover * shade)), size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], 2)
    behind = patch.of(image) * (1 - layers[:, :, :1])
    behind += layers[:, :, 1:] * np.array(BALL_BGR, np.float32) + 0.5
    patch.of(image)[:] = behind.astype(np.uint8)


def _cast(
    rays: tuple[NDArray[np.float64], NDArray[np.float64]],
    middle: tuple[float, float],
    centre_m: Vector,
    radius_m: float,
) -> tuple[Plane, Plane]:
    """Return the share of each sample that the ball covers, and how brightly it shines there.

    A ray hits where ``g = (d·c)² - |d|² (|c|² - r²)`` is positive. That is a polynomial in the ray's x and y; it is
    developed around the middle of the silhouette, so that single precision is enough however far the ball is.
    """
    (x, y, z), (u0, v0) = centre_m, middle
    power = x * x + y * y + z * z - radius_m * radius_m
    ahead0 = u0 * x + v0 * y + z
    du = (rays[0] - u0).astype(np.float32)[None, :]
    dv = (rays[1] - v0).astype(np.float32)[:, None]
    slope_u, slope_v = 2 * (ahead0 * x - power * u0), 2 * (ahead0 * y - power * v0)
    bend_u, bend_v, twist = x * x - power, y * y - power, 2 * x * y
    middle_g = ahead0 * ahead0 - (u0 * u0 + v0 * v0 + 1) * power
    g = (bend_u * du * du + slope_u * du + middle_g) + (bend_v * dv * dv + slope_v * dv) + dv * (twist * du)
    per_u = (((2 * bend_u) * du + slope_u) + twist * dv) * _step(rays[0])
    per_v = (((2 * bend_v) * dv + slope_v) + twist * du) * _step(rays[1])
    inside_samples = g / (cv2.magnitude(per_u, per_v) + np.float32(1e-12))
    ahead = (x * du + ahead0) + y * dv
    cover = np.clip(inside_samples + np.float32(0.5), 0, 1) * (ahead > 0)
    squared = (rays[0] ** 2 + 1).astype(np.float32)[None, :] + (rays[1] ** 2).astype(np.float32)[:, None]
    depth_m = (ahead - np.sqrt(np.maximum(g, 0))) / squared
    return cover, _shade(depth_m, rays, centre_m, radius_m)


def _step(rays: NDArray[np.float64]) -> np.float32:
    """Return the distance between two samples; of a ball of which one column or row is in the picture, none is known.

    Its edge is then as sharp as a sample.
    """
    return np.float32(abs(float(rays[1] - rays[0])) if len(rays) > 1 else 0.0)


def _shade(
    depth_m: Plane, rays: tuple[NDArray[np.float64], NDArray[np.float64]], centre_m: Vector, radius_m: float
) -> Plane:
    """Return the brightness of a matte surface by Lambert's cosine law, with some light from all sides."""
    light_x, light_y, light_z = (part / math.hypot(*LIGHT) for part in LIGHT)
    along = (light_x * rays[0] + light_z).astype(np.float32)[None, :] + (light_y * rays[1]).astype(np.float32)[:, None]
    behind_m = light_x * centre_m[0] + light_y * centre_m[1] + light_z * centre_m[2]
    cosine = (depth_m * along - np.float32(behind_m)) * np.float32(1 / radius_m)
    shade: Plane = np.clip(cosine, 0, 1) * np.float32(1 - MIN_SHADE) + np.float32(MIN_SHADE)
    return shade


def paint_shadow(image: Image, model: CameraModel, centre_m: Vector, radius_m: float, camera_height_m: float) -> None:
    """Darken the floor under a ball; its centre is in the camera frame: x right, y down, z forward."""
    x, y, z = centre_m
    reach_m = 2 * radius_m
    near_m = z - reach_m
    if near_m < reach_m:
        return
    sides = [(x + side) / depth for side in (-reach_m, reach_m) for depth in (near_m, z + reach_m)]
    extent_px = (
        model.cx_px + model.fx_px * min(sides),
        model.cy_px + model.fy_px * camera_height_m / (z + reach_m),
        model.cx_px + model.fx_px * max(sides),
        model.cy_px + model.fy_px * camera_height_m / near_m,
    )
    patch = _patch(model, extent_px)
    if patch is None:
        return
    columns, rows = patch.rays(model, 1)
    depth_m = camera_height_m / np.maximum(rows, 1e-6)[:, None]
    off_squared = ((columns[None, :] * depth_m - x) ** 2 + (depth_m - z) ** 2) / radius_m**2
    gap = max(0.0, camera_height_m - y - radius_m) / radius_m
    light = 1 - SHADOW_DEPTH * math.exp(-gap) * np.exp(-1.5 * off_squared)
    patch.of(image)[:] = (patch.of(image) * light[:, :, None].astype(np.float32) + 0.5).astype(np.uint8)


# What the camera sees around the ball: walls at a distance that stays, whatever is driven; a room in true perspective,
# with carpets and furniture; and one that is too plain to show any motion.
RoomKind = Literal["backdrop", "textured", "plain"]
Floats = NDArray[np.floating]

# No yellow, no green, nothing dark: a colour range that finds the ball must find nothing else.
WALL_DISTANCE_M = 5.0
TILE_M = 0.5
MAX_PANORAMA_WIDTH_PX = 4096
WALL_COLOURS_BGR = ((196, 208, 216), (205, 204, 200), (188, 196, 208), (208, 210, 214))
FLOOR_COLOURS_BGR = ((104, 118, 134), (84, 96, 110))
SKIRTING_BGR = (226, 228, 230)
THINGS_BGR = (
    (148, 96, 62),
    (60, 62, 150),
    (72, 92, 128),
    (120, 112, 108),
    (156, 74, 96),
    (70, 78, 92),
    (172, 140, 118),
)

# Pixels by which the noise is larger than a picture each way: 4096 places to cut it from.
SPARE_PX = 64

# The noise of a second camera is that of frames so much later.
OTHER_NOISE = 1 << 40

# The time that a reader of a blocked camera waits.
TIMEOUT_S = 0.1


class Room:
    """A room around a camera that stands in its centre and turns; what hangs on the walls follows from the seed."""

    def __init__(self, model: CameraModel, camera_height_m: float, seed: int) -> None:
        scale = min(1.0, MAX_PANORAMA_WIDTH_PX / (2 * math.pi * model.fx_px))
        self._turn_px = round(2 * math.pi * model.fx_px * scale)
        per_rad = self._turn_px / (2 * math.pi)
        sideways = (np.arange(model.width_px) - model.cx_px) / model.fx_px
        down = (np.arange(model.height_px) - model.cy_px) / model.fy_px
        azimuths = np.arctan(sideways)
        self._left_px = math.floor(azimuths[0] * per_rad)
        self._view_px = math.ceil(azimuths[-1] * per_rad) + 2 - self._left_px
        top, bottom = min(down[0], 0.0), max(down[-1], 0.0)
        rows = math.ceil((bottom - top) * per_rad) + 2
        columns = np.broadcast_to(azimuths * per_rad - self._left_px, (model.height_px, model.width_px))
        lines = (down[:, None] * np.cos(azimuths)[None, :] - top) * per_rad
        self._maps = cv2.convertMaps(columns.astype(np.float32), lines.astype(np.float32), cv2.CV_16SC2)
        panorama = _panorama(self._turn_px, top + np.arange(rows) / per_rad, camera_height_m, seed)
        self._panorama = panorama[:, np.arange(self._turn_px + self._view_px) % self._turn_px]

    def view(self, heading_rad: float, _place_m: tuple[float, float] = (0.0, 0.0), _tilt_rad: float = 0.0) -> Image:
        """Draw what the level camera sees at a heading, counter-clockwise from east, as a new picture, blue first."""
        first = (round(-heading_rad / (2 * math.pi) * self._turn_px) + self._left_px) % self._turn_px
        window = self._panorama[:, first : first + self._view_px]
        return np.asarray(cv2.remap(window, *self._maps, cv2.INTER_LINEAR), np.uint8)


def _panorama(turn_px: int, down: Floats, camera_height_m: float, seed: int) -> Image:
    """Draw the room on a cylinder; ``down`` is how far each row looks down per unit of distance along the floor."""
    rng = np.random.default_rng(seed)
    clockwise = np.arange(turn_px) * (2 * math.pi / turn_px)
    east, south = np.cos(clockwise), np.sin(clockwise)
    wall_m = (WALL_DISTANCE_M / np.maximum(np.abs(east), np.abs(south))).astype(np.float32)
    height_m = camera_height_m - down.astype(np.float32)[:, None] * wall_m[None, :]
    picture = _walls(clockwise, wall_m, height_m, rng)
    _lay_floor(picture, (east, south), down, camera_height_m, height_m < 0)
    picture += _stains(picture.shape[:2], rng)[:, :, None]
    painted: Image = np.clip(picture, 0, 255).astype(np.uint8)
    return painted


def _walls(clockwise: Floats, wall_m: Plane, height_m: Plane, rng: np.random.Generator) -> Plane:
    wall = np.floor(clockwise / (math.pi / 2) + 0.5).astype(int) % 4
    along_m = wall_m * np.sin(clockwise - np.round(clockwise / (math.pi / 2)) * (math.pi / 2))
    picture: Plane = np.array(WALL_COLOURS_BGR, np.float32)[wall][None] * np.ones((len(height_m), 1, 1), np.float32)
    picture *= (0.88 + 0.06 * np.clip(height_m, 0, 2.5))[:, :, None]
    for number in range(4):
        _furnish(picture, np.where(wall == number, along_m, np.inf), height_m, rng)
    picture[(height_m >= 0) & (height_m < 0.09)] = SKIRTING_BGR
    return picture


def _furnish(picture: Plane, along_m: Floats, height_m: Plane, rng: np.random.Generator) -> None:
    """Put pictures on a wall and cupboards in front of it."""
    for place_m in np.arange(-4.2, 4.2, 1.4):
        left_m, width_m = place_m + rng.uniform(0, 0.4), rng.uniform(0.4, 1.0)
        hangs = rng.random() < 0.5
        low_m, high_m = (rng.uniform(0.7, 1.1), rng.uniform(1.3, 1.9)) if hangs else (0.0, rng.uniform(0.4, 1.4))
        colour = np.array(THINGS_BGR[rng.integers(len(THINGS_BGR))], np.float32)
        for inset_m, shade in ((0.0, 0.8), (0.05, 1.0)):
            across = np.abs(along_m - left_m - width_m / 2) < width_m / 2 - inset_m
            columns = np.flatnonzero(across)
            up = (height_m[:, columns] >= low_m + inset_m) & (height_m[:, columns] < high_m - inset_m)
            picture[:, columns] = np.where(up[:, :, None], colour * shade, picture[:, columns])


def _lay_floor(
    picture: Plane, compass: tuple[Floats, Floats], down: Floats, camera_height_m: float, is_floor: NDArray[np.bool_]
) -> None:
    """Lay tiles where the floor shows; far away, where they are finer than pixels, they fade into their mean."""
    first = int(np.argmax(is_floor.any(axis=1)))
    away_m = camera_height_m / np.maximum(down[first:], 1e-6)[:, None]
    tiles = np.floor(away_m * compass[0] / TILE_M) + np.floor(away_m * compass[1] / TILE_M)
    contrast = np.clip(1.6 - away_m / 3, 0, 1)
    share = (0.5 + (tiles % 2 - 0.5) * contrast)[:, :, None].astype(np.float32)
    light, dark = (np.array(colour, np.float32) for colour in FLOOR_COLOURS_BGR)
    floor = dark + (light - dark) * share
    picture[first:] = np.where(is_floor[first:, :, None], floor, picture[first:])


def _stains(shape: tuple[int, ...], rng: np.random.Generator) -> Plane:
    """Return broad, faint differences in brightness that close around the cylinder: no real wall is even."""
    rows, columns = max(2, shape[0] // 24), max(2, shape[1] // 24)
    coarse = rng.normal(0.0, 5.0, (rows, columns)).astype(np.float32)
    around = np.hstack((coarse[:, -2:], coarse, coarse[:, :2]))
    margin_px = round(2 * shape[1] / columns)
    wide = cv2.resize(around, (shape[1] + 2 * margin_px, shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(wide, np.float32)[:, margin_px : margin_px + shape[1]]


class Renderer:
    """Draws pictures through a pinhole: a room, a ball in it, and the sensor's noise.

    The same arguments always give the same picture. `noise` is its standard deviation in grey levels of 255.
    """

    def __init__(
        self, model: CameraModel, *, camera_height_m: float, seed: int, noise: float, room: RoomKind = "backdrop"
    ) -> None:
        self._model = model
        self._camera_height_m = camera_height_m
        self._room = (
            Room(model, camera_height_m, seed)
            if room == "backdrop"
            else TexturedRoom(model, camera_height_m, seed, TEXTURE_CONTRAST if room == "textured" else 0.0)
        )
        self._noise = _SensorNoise(model, seed, noise) if noise > 0 else None

    def render(
        self,
        ball_m: Vector | None,
        radius_m: float,
        heading_rad: float,
        sequence: int = 0,
        place_m: tuple[float, float] = (0.0, 0.0),
        tilt_rad: float = 0.0,
    ) -> Image:
        """Draw a new picture, blue first, shape ``(height, width, 3)``.

        Args:
            ball_m: The ball's centre in the camera frame: x right, y down, z forward; None for no ball.
            heading_rad: Where the camera looks, counter-clockwise from east.
            sequence: The frame's number, from which its noise follows.
            place_m: Where the camera is, to the east and to the north; the backdrop is the same from everywhere.
            tilt_rad: How far it looks up. The backdrop stays level, and only a level camera sees the ball's shadow.
        """
        image = self._room.view(heading_rad, place_m, tilt_rad)
        if ball_m is not None:
            if not tilt_rad:
                paint_shadow(image, self._model, ball_m, radius_m, self._camera_height_m)
            paint_ball(image, self._model, ball_m, radius_m)
        return self.add_noise(image, sequence)

    def add_noise(self, image: Image, sequence: int) -> Image:
        """Add the noise of a frame to a picture, and return it."""
        if self._noise:
            self._noise.add_to(image, sequence)
        return image


class _SensorNoise:
    """Gaussian noise, made once: each frame cuts its own from a larger sheet.

    Brighter and darker are kept apart, so that adding is two saturating additions of bytes.
    """

    def __init__(self, model: CameraModel, seed: int, sigma: float) -> None:
        self._seed = seed
        shape = (model.height_px + SPARE_PX, model.width_px + SPARE_PX, 3)
        sheet = np.random.default_rng((seed, 1)).standard_normal(shape, dtype=np.float32) * np.float32(sigma)
        self._brighter = np.clip(np.rint(sheet), 0, 255).astype(np.uint8)
        self._darker = np.clip(np.rint(-sheet), 0, 255).astype(np.uint8)

    def add_to(self, image: Image, sequence: int) -> None:
        bits = scramble(self._seed, sequence)
        top, left = bits % SPARE_PX, (bits >> 16) % SPARE_PX
        rows, columns = slice(top, top + image.shape[0]), slice(left, left + image.shape[1])
        cv2.add(image, self._brighter[rows, columns], dst=image)
        cv2.subtract(image, self._darker[rows, columns], dst=image)


class SimulatedCameraOptions(DriverOptions):
    """The options of a simulated camera, which draws the `[world]`."""

    needs_world: ClassVar = True

    # Between two frames the stepped clock goes through every timer of the run: at 1e-12 Hz, for ever.
    rate: Annotated[Frequency, Field(ge=0.01)] = 30.0
    """Frames in a second."""
    render: bool = True
    """Whether to draw pictures. Without, every frame is black and costs nothing: for the detector ``ideal``."""
    noise: float = Field(default=2.0, ge=0, le=64)
    """Standard deviation of the sensor's noise in grey levels of 255."""
    latency: Annotated[Duration, Field(le=1)] = 0.0
    """How old a picture is when it is delivered, in seconds. Its capture time says so."""
    room: RoomKind = "backdrop"
    """What is around the ball: ``backdrop`` shows that the robot turns, ``textured`` and ``plain`` are in true
    perspective. Only with the latter two is liveness judged by motion."""

    baseline: Coordinate = 0.0
    """Of a second camera, in metres: how far it is to the right of the first one."""

    def build(self, context: DriverContext) -> SimulatedCamera:
        """Return the camera."""
        return SimulatedCamera(self, context)


class SimulatedCamera:
    """A camera on the simulated robot, looking straight ahead, and level unless a servo tilts it.

    Its frames are at whole multiples of the frame time from when it was first opened; those that were not read in time
    are passed over. It honours the knobs of the world. Frozen, it delivers the same old frame again and again, with its
    old number and time, as a stuck driver does. With a frozen sensor its frames are new, with new times, and show the
    same old view: under a clock that runs, or with noise that is added anew.

    Raises:
        ConfigError: The run has no camera model or no world.
    """

    is_live = False  # time passes as frames are read
    remarks: tuple[str, ...] = ()  # there is no device that could refuse a setting
    not_for_motion = ""  # the capture times are exact

    def __init__(self, options: SimulatedCameraOptions, context: DriverContext) -> None:
        self._name = context.name
        self._model = lens(context)
        self._world: World = shared_world(context)
        self._clock = context.clock
        self._rate_hz = options.rate
        self._blank = np.zeros((self._model.height_px, self._model.width_px, 3), np.uint8)
        self._blank.flags.writeable = False
        self._noise = options.noise if options.render else None
        self._latency_s = options.latency
        self._room = options.room
        self._baseline_m = options.baseline
        self._view: Image | None = None
        self._renderer: Renderer | None = None
        self._is_open = False
        self._start_s: float | None = None
        self._sequence = -1
        self._newest: Frame | None = None

    @property
    def shows_own_motion(self) -> bool:
        """True if it draws a room in true perspective: the backdrop does not come nearer."""
        return self._noise is not None and self._room != "backdrop"

    def open(self) -> None:
        """Make ready to read. Frames are numbered on if the camera was open before."""
        if self._noise is not None and self._renderer is None:
            self._renderer = Renderer(
                self._model,
                camera_height_m=self._world.camera_height_m,
                seed=self._world.seed,
                noise=self._noise,
                room=self._room,
            )
        if self._start_s is None:
            self._start_s = self._clock.now_s()
        self._is_open = True

    def read(self) -> Frame:
        """Move the clock to the next frame's time and return that frame, or the previous one while it is frozen.

        Raises:
            CaptureTimeoutError: The camera is blocked; `TIMEOUT_S` have passed.
        """
        if not self._is_open or self._start_s is None:
            raise DeviceClosedError(f"the simulated camera '{self._name}' is not open")
        if self._baseline_m:
            if self._world.faults.second_camera_blocked:
                raise CaptureTimeoutError("the simulated second camera is blocked")
        elif self._world.faults.camera_blocked:
            self._clock.sleep_until_s(self._clock.now_s() + TIMEOUT_S)
            raise CaptureTimeoutError(f"the simulated camera is blocked: no frame for {TIMEOUT_S * 1e3:.0f} ms")
        self._sequence = self._next_sequence(self._start_s)
        captured_at_s = self._start_s + (self._sequence + 1) / self._rate_hz
        self._clock.sleep_until_s(captured_at_s + self._latency_s)
        if not self._baseline_m:
            self._world.look(self._model, captured_at_s)
        if self._newest is None or self._baseline_m or not self._world.faults.camera_frozen:
            self._newest = Frame(self._picture(captured_at_s), captured_at_s, self._sequence)
        return self._newest

    def close(self) -> None:
        """Be closed. May be called any number of times."""
        self._is_open = False

    def _next_sequence(self, start_s: float) -> int:
        """Return the number of the first frame that is not in the past and was not read yet."""
        gone = math.ceil((self._clock.now_s() - self._latency_s - start_s) * self._rate_hz - 1e-6) - 1
        return max(self._sequence + 1, gone)

    def _picture(self, time_s: float) -> Image:
        if self._renderer is None:
            return self._blank
        faults = self._world.faults
        if self._baseline_m:
            faults = Faults(target_hidden=faults.target_hidden)  # the rest is about the first camera
        if self._view is not None and faults.frozen_under_clock:
            return _with_clock(self._view, time_s)
        if self._view is not None and faults.frozen_under_noise:
            return self._renderer.add_noise(self._view.copy(), self._sequence)
        ball_m = None if faults.target_hidden else self._world.target_in_camera(time_s, self._baseline_m)
        pose = self._world.robot.pose_at(time_s)
        right_m, radius_m = self._baseline_m, self._world.ball.diameter_m / 2
        place_m = pose.x_m + right_m * math.sin(pose.heading_rad), pose.y_m - right_m * math.cos(pose.heading_rad)
        tilt_rad = self._world.tilt_joint.pose_at(time_s).heading_rad
        noise = self._sequence + (OTHER_NOISE if right_m else 0)
        self._view = self._renderer.render(ball_m, radius_m, pose.heading_rad, noise, place_m, tilt_rad)
        return self._view


def _with_clock(view: Image, time_s: float) -> Image:
    """Return a picture with a clock in its upper left corner, as IP cameras draw one, here with hundredths."""
    image = view.copy()
    scale = image.shape[1] / 640
    place_px, white = (8, round(24 * scale)), (255, 255, 255)
    cv2.putText(image, f"2026-11-23 {time_s:09.2f}", place_px, cv2.FONT_HERSHEY_SIMPLEX, scale, white, 2)
    return image


def lens(context: DriverContext) -> CameraModel:
    """Return the camera model of a run, or raise a `ConfigError` if it has none."""
    if context.camera_model is None:
        raise ConfigError(f"'{context.name}' is simulated and needs a lens to look through; set model in [camera]")
    return context.camera_model


# A room in true perspective: unlike the backdrop, it shows that the camera drives, and not only that it turns ---


# The room goes from -5 m to 5 m both ways and is 2.5 m high. A robot that drives through a wall is in the next such
# room, so that it may go anywhere.
HALF_ROOM_M = 5.0
CEILING_M = 2.5

# Its one texture covers 10.24 m and has a grey level every 2 cm; each wall shows another part of it.
TEXTURE_PX = 512
PX_PER_M = 50.0
WALLS_APART_M = 3.3

# Patterns of 8, 32 and 128 cm, with their shares of the contrast: carpets and wallpaper, pictures, furniture.
OCTAVES = ((4, 0.5), (16, 0.6), (64, 0.6))

# No yellow, no green, nothing dark, as in the backdrop.
PAINT_BGR = (168, 158, 150)
FLOOR_BGR = (132, 126, 122)
MIN_BRIGHTNESS, MAX_BRIGHTNESS = 60, 235

# The standard deviation of the grey levels of a room with carpets, pictures and furniture.
TEXTURE_CONTRAST = 24.0


class TexturedRoom:
    """A room of floor, ceiling and four walls, seen through a pinhole.

    Args:
        contrast: Standard deviation of the grey levels of its texture; 0 for a plain room.
    """

    def __init__(self, model: CameraModel, camera_height_m: float, seed: int, contrast: float) -> None:
        self._texture = _paint(seed) * np.float32(contrast)
        self._sideways = ((np.arange(model.width_px) - model.cx_px) / model.fx_px).astype(np.float32)[None, :]
        self._down = ((np.arange(model.height_px) - model.cy_px) / model.fy_px).astype(np.float32)[:, None]
        self._camera_height_m = camera_height_m

    def view(self, heading_rad: float, place_m: tuple[float, float] = (0.0, 0.0), tilt_rad: float = 0.0) -> Image:
        """Draw what the camera sees from a place, as a new picture, blue first.

        Args:
            heading_rad: Where it looks, counter-clockwise from east.
            place_m: Where it is, to the east and to the north.
            tilt_rad: How far it looks up.
        """
        cos, sin = np.float32(math.cos(heading_rad)), np.float32(math.sin(heading_rad))
        level, up = np.float32(math.cos(tilt_rad)), np.float32(math.sin(tilt_rad))
        # Each pixel's direction per unit of the way over the floor, as a level camera has it.
        forward = np.maximum(level + self._down * up, np.float32(1e-3))
        sideways = self._sideways / forward if tilt_rad else self._sideways
        down = (self._down * level - up) / forward
        # The depth at which a row meets the floor, or above the horizon the ceiling.
        height_m = np.where(down > 0, self._camera_height_m, CEILING_M - self._camera_height_m)
        flat_m = (height_m / np.maximum(np.abs(down), 1e-6)).astype(np.float32)
        # Each column's direction over the floor, per unit of depth.
        east, north = cos + sideways * sin, sin - sideways * cos
        x_m, y_m = (np.float32(_in_room(each)) for each in place_m)
        to_x_m, to_y_m = _to_wall(x_m, east), _to_wall(y_m, north)
        wall_m = np.minimum(to_x_m, to_y_m)
        along_m = np.where(to_x_m < to_y_m, y_m + to_x_m * north, x_m + to_y_m * east)
        wall = np.where(to_x_m < to_y_m, 1 + (east > 0), 3 + (north > 0))
        is_wall = wall_m <= flat_m
        depth_m = np.where(is_wall, wall_m, flat_m)
        along_m = along_m + (wall * WALLS_APART_M).astype(np.float32)
        across_m = np.where(is_wall, along_m, x_m + depth_m * east)
        other_m = np.where(is_wall, self._camera_height_m - down * depth_m, y_m + depth_m * north)
        columns, rows = (np.asarray(each * PX_PER_M, np.float32) for each in (across_m, other_m))
        grey = cv2.remap(self._texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        # Far away on the floor the texture is finer than pixels, and fades into its mean.
        grey *= np.where(is_wall, np.float32(1), np.clip(1.6 - depth_m / 3, 0, 1))
        levels = [
            np.where(is_wall, np.float32(wall_level), np.float32(floor_level)) + grey
            for wall_level, floor_level in zip(PAINT_BGR, FLOOR_BGR, strict=True)
        ]
        return np.asarray(np.clip(cv2.merge(levels), MIN_BRIGHTNESS, MAX_BRIGHTNESS), np.uint8)


def _in_room(place_m: float) -> float:
    return (place_m + HALF_ROOM_M) % (2 * HALF_ROOM_M) - HALF_ROOM_M


def _to_wall(place_m: np.float32, direction: Plane) -> Plane:
    """Return the depth at which each column meets the wall that it looks at, along one axis."""
    aside_m = np.where(direction > 0, HALF_ROOM_M - place_m, HALF_ROOM_M + place_m)
    return np.asarray(aside_m / np.maximum(np.abs(direction), 1e-6), np.float32)


def _paint(seed: int) -> Plane:
    """Return a pattern that repeats, with a mean of 0 and a standard deviation of 1."""
    rng = np.random.default_rng((seed, 2))
    painted = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    for pitch_px, share in OCTAVES:
        coarse = rng.standard_normal((TEXTURE_PX // pitch_px, TEXTURE_PX // pitch_px)).astype(np.float32)
        wrapped = np.pad(coarse, 2, mode="wrap")
        wide = cv2.resize(wrapped, None, fx=pitch_px, fy=pitch_px, interpolation=cv2.INTER_CUBIC)
        painted += share * wide[2 * pitch_px : -2 * pitch_px, 2 * pitch_px : -2 * pitch_px]
    return np.asarray((painted - painted.mean()) / painted.std(), np.float32)


# Numbers that look random and follow from keys: the same keys, the same numbers -------------------


# Of SplitMix64.
_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15


def scramble(*keys: int) -> int:
    """Return 64 bits that look random and depend on every bit of every key, in order.

    It is the output function of SplitMix64 (G. Steele, D. Lea and C. Flood, "Fast splittable pseudorandom number
    generators", 2014), once for each key. Ten times cheaper than seeding a generator for each frame.
    """
    state = 0
    for key in keys:
        state = (state + _GOLDEN + key) & _MASK
        state = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        state = ((state ^ (state >> 27)) * 0x94D049BB133111EB) & _MASK
        state ^= state >> 31
    return state


def gaussian_pair(*keys: int) -> tuple[float, float]:
    """Return two independent numbers of the standard normal distribution, by the Box-Muller transform, from keys."""
    bits = scramble(*keys)
    radius = math.sqrt(-2.0 * math.log(((bits >> 32) + 1) / 2**32))
    angle = 2.0 * math.pi * (bits & 0xFFFFFFFF) / 2**32
    return (radius * math.cos(angle), radius * math.sin(angle))
