"""The moving picture of the README: what the demonstration's camera sees, and what its rules make of it.

``python docs/pictures/moving_picture.py`` writes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.frame import Frame

PATH = Path(__file__).parent / "demo.webp"
BYTES_MAX = 400_000

PARTS_S = ((6.0, 10.9), (20.4, 28.5))
"""What is shown of the simulated minute: the ball rolls away and is followed, then comes close and leaves."""

STEP_S = 0.27
"""From picture to picture in the simulated world."""

SHOWN_MS = 130
"""For how long each picture stands, so that everything goes twice as fast as in the demonstration."""

SIZE = (800, 336)
CAMERA_SIZE = (416, 312)
FINER = 2
"""Everything is drawn so much larger first, for smooth edges."""

QUALITY = 70
NOISE = 11
"""A pixel that changes by less than this stays as it was: noise of the camera, which takes most of the bytes."""

GROUND, PANEL, LINE = (16, 20, 28), (27, 33, 44), (62, 72, 90)
WORDS, DIM = (226, 231, 240), (150, 160, 178)
BALL, RED, BLUE, GREEN = (196, 230, 60), (255, 107, 107), (102, 168, 255), (110, 214, 140)

Colour = tuple[int, int, int]


class Moment(Struct, frozen=True, kw_only=True):
    """What is shown in one picture.

    Attributes:
        seen: What the camera sees, red first.
        outline: The outline of the ball in it, in order around its centre; empty if it is not found.
        active: Of each rule, whether it is active.
        levels: What each output does, from 0 to 1.
    """

    seen: NDArray[np.uint8]
    outline: NDArray[np.float64]
    distance_m: float
    sigma_m: float
    active: dict[str, bool]
    levels: dict[str, float]
    speed_mps: float


def watch_demonstration() -> list[Moment]:
    """Run the demonstration on the simulated clock, as fast as it goes, and return what is shown of it."""
    loop = Loop(build(demo_configuration(), speed=None))
    moments = list[Moment]()
    due = [at for begin, end in PARTS_S for at in np.arange(begin, end, STEP_S).tolist()]

    def watch(record: CycleRecord, frame: Frame | None) -> None:
        if not due:
            loop.stop("all is shown")
        elif frame is not None and record.observation.now_s >= due[0]:
            due.pop(0)
            moments.append(_moment(record, frame))

    loop.listeners.append(watch)
    loop.run()
    return moments


def _moment(record: CycleRecord, frame: Frame) -> Moment:
    (track,), (found,) = record.decision.tracks, record.detections
    around = found.outline_px - found.centre_px
    commands = record.decision.commands
    return Moment(
        seen=np.ascontiguousarray(frame.image[:, :, ::-1]),
        outline=found.outline_px[np.argsort(np.arctan2(around[:, 1], around[:, 0]))],
        distance_m=track.distance_m or 0.0,
        sigma_m=track.sigma_m or 0.0,
        active={trace.rule: bool(trace.active) for trace in record.decision.rules},
        levels={each.output: each.level for each in commands if isinstance(each, LevelCommand)},
        speed_mps=sum(each.linear_mps for each in commands if isinstance(each, TwistCommand)),
    )


class Drawing:
    """One picture while it is drawn; places and sizes are pixels of the finished one."""

    def __init__(self) -> None:
        """Begin with an empty ground."""
        self.image = Image.new("RGB", (SIZE[0] * FINER, SIZE[1] * FINER), GROUND)
        self._pen = ImageDraw.Draw(self.image)

    def paste(self, pixels: NDArray[np.uint8], left: float, top: float) -> None:
        """Put pixels there, in the size that everything is drawn in."""
        self.image.paste(Image.fromarray(pixels), (round(left * FINER), round(top * FINER)))

    def write(self, text: str, at: tuple[float, float], size: float, colour: Colour, *, anchor: str = "ls") -> None:
        """Write a line; bold from 20 pixels on."""
        face = "DejaVuSans-Bold.ttf" if size >= 20 else "DejaVuSans.ttf"
        file = Path(mpl.get_data_path()) / "fonts" / "ttf" / face
        font = ImageFont.truetype(str(file), round(size * FINER))
        self._pen.text((at[0] * FINER, at[1] * FINER), text, fill=colour, font=font, anchor=anchor)

    def box(self, box: tuple[float, float, float, float], colour: Colour, radius: float = 0) -> None:
        """Fill a box with round corners."""
        left, top, right, bottom = (each * FINER for each in box)
        self._pen.rounded_rectangle((left, top, right - 1, bottom - 1), radius * FINER, fill=colour)

    def line(self, points: Sequence[tuple[float, float]], colour: Colour, width: float) -> None:
        """Draw a line through points."""
        fine = [(x * FINER, y * FINER) for x, y in points]
        self._pen.line(fine, fill=colour, width=round(width * FINER), joint="curve")

    def disc(self, at: tuple[float, float], radius: float, colour: Colour) -> None:
        """Fill a circle."""
        self._pen.circle((at[0] * FINER, at[1] * FINER), radius * FINER, fill=colour)

    def finished(self) -> NDArray[np.uint8]:
        """Return the pixels of the picture in its size."""
        return np.asarray(self.image.resize(SIZE, Image.Resampling.LANCZOS))


MARGIN = 12
RIGHT = MARGIN + CAMERA_SIZE[0] + 20
FAR_M = 4.0
ZONES_M: tuple[tuple[float, float, Colour], ...] = ((0.0, 0.5, RED), (3.048, 3.66, BLUE))
"""Where the rules near and far of the demonstration act."""


def draw(moment: Moment) -> NDArray[np.uint8]:
    """Return the picture of a moment."""
    drawing = Drawing()
    _draw_camera(drawing, moment)
    end = SIZE[0] - MARGIN
    drawing.write("distance of the ball", (RIGHT, 26), 13, DIM)
    drawing.write(f"{moment.distance_m:.3f} m", (RIGHT, 68), 38, BALL)
    drawing.write(f"± {1000 * moment.sigma_m:.1f} mm", (end, 68), 22, WORDS, anchor="rs")
    _draw_scale(drawing, moment.distance_m, end)
    rows: tuple[tuple[str, str, str, float, Colour, bool], ...] = (
        ("near", "below 50 cm", "buzzer", moment.levels["buzzer"], RED, moment.active["near"]),
        ("far", "beyond 3.05 m", "motor", moment.levels["motor"], BLUE, moment.active["far"]),
        ("follow", "keep 1 m", "robot", moment.speed_mps / 0.4, GREEN, moment.active["follow"]),
    )
    for index, row in enumerate(rows):
        _draw_rule(drawing, 146 + 62 * index, end, row)
    return drawing.finished()


def _draw_camera(drawing: Drawing, moment: Moment) -> None:
    scale = CAMERA_SIZE[0] / moment.seen.shape[1]
    size = (CAMERA_SIZE[0] * FINER, CAMERA_SIZE[1] * FINER)
    drawing.paste(cv2.resize(moment.seen, size, interpolation=cv2.INTER_AREA), MARGIN, MARGIN)
    if not len(moment.outline):
        return
    rim = [(MARGIN + x * scale, MARGIN + y * scale) for x, y in (moment.outline + 0.5).tolist()]
    for colour, width in ((GROUND, 5), (BALL, 2.5)):
        drawing.line([*rim, rim[0], rim[1]], colour, width)
    words = f"{moment.distance_m:.3f} m ± {1000 * moment.sigma_m:.1f} mm"
    left, top = min(x for x, _ in rim), min(y for _, y in rim)
    left = max(MARGIN + 6, min(left, MARGIN + CAMERA_SIZE[0] - 158))
    drawing.box((left - 4, top - 27, left + 150, top - 7), GROUND, 4)
    drawing.write(words, (left + 2, top - 12), 14, BALL)


def _draw_scale(drawing: Drawing, distance_m: float, end: float) -> None:
    width, top = end - RIGHT, 92

    def place(metres: float) -> float:
        return RIGHT + width * min(metres, FAR_M) / FAR_M

    drawing.box((RIGHT, top, end, top + 8), LINE, 4)
    for begin_m, end_m, colour in ZONES_M:
        drawing.box((place(begin_m), top, place(end_m), top + 8), colour, 4)
    for metres, anchor in enumerate(("ls", "ms", "ms", "ms", "rs")):
        drawing.write(f"{metres} m", (place(metres), 120), 11, DIM, anchor=anchor)
    drawing.disc((place(distance_m), top + 4), 11, GROUND)
    drawing.disc((place(distance_m), top + 4), 8, BALL)


def _draw_rule(drawing: Drawing, top: float, end: float, row: tuple[str, str, str, float, Colour, bool]) -> None:
    name, says, output, level, colour, is_active = row
    drawing.box((RIGHT, top, end, top + 54), PANEL, 6)
    drawing.box((RIGHT, top, RIGHT + 5, top + 54), colour if is_active else LINE, 2)
    drawing.write(name, (RIGHT + 16, top + 23), 15, WORDS)
    drawing.write(says, (RIGHT + 16, top + 42), 12, DIM)
    drawing.write("active" if is_active else "idle", (RIGHT + 126, top + 33), 13, colour if is_active else DIM)
    drawing.write(output, (RIGHT + 190, top + 23), 13, WORDS if is_active else DIM)
    drawing.write(f"{100 * level:.0f} %", (end - 10, top + 23), 13, WORDS if level else DIM, anchor="rs")
    left, right = RIGHT + 190, end - 10
    drawing.box((left, top + 33, right, top + 41), LINE, 4)
    if level > 0.02:
        drawing.box((left, top + 33, left + max(8, (right - left) * min(1.0, level)), top + 41), colour, 4)


def save(pictures: Sequence[NDArray[np.uint8]], path: Path) -> None:
    """Write pictures as an animated WebP that goes round for ever."""
    camera = np.s_[MARGIN : MARGIN + CAMERA_SIZE[1], MARGIN : MARGIN + CAMERA_SIZE[0]]
    held = [pictures[0]]
    for now in pictures[1:]:
        calm = now.copy()
        seen, before = now[camera], held[-1][camera]
        changed = np.abs(seen.astype(np.int16) - before).max(axis=2, keepdims=True) > NOISE
        calm[camera] = np.where(changed, seen, before)
        held.append(calm)
    first, *others = map(Image.fromarray, held)
    first.save(
        path, save_all=True, append_images=others, duration=SHOWN_MS, loop=0, quality=QUALITY, method=6,
        minimize_size=True,
    )  # fmt: skip


def make_moving_picture(path: Path = PATH) -> None:
    """Make the moving picture.

    Args:
        path: The file to write.
    """
    save([draw(moment) for moment in watch_demonstration()], path)


if __name__ == "__main__":
    make_moving_picture()
