"""How many sheets, balls and tags on real pictures of other people are found, beside the tutorial and a plain method.

The pictures are no part of the repository; their ``truth.json`` holds outlines that were set by eye. A target is found
if its middle is within a tenth of its size, and each side, or the diameter, within 5 % (a radius within 1 px); wrong if
something else is reported. Rooms without a target count what is measured there for sure, and perhaps.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import ours
import tutorial
from numpy.typing import NDArray
from part import Part, table

from stadimeter.config.camera_file import load_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus, Points
from stadimeter.core.frame import Image

PICTURES = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
METHODS = ("stadimeter", "tutorial", "plain")
FOCAL_SHARE = 0.9
"""The focal length of the pictures' cameras is not known: this share of the longer side."""

ROOMS = {
    "A4": ("sheet", {"width": "297 mm", "height": "210 mm"}),
    "ball of any colour": ("ball", {"diameter": "6.7 cm"}),
    "green ball": ("ball", {"diameter": "6.7 cm", "hsv": "20,46,108:43,255,255"}),
    "orange ball": ("ball", {"diameter": "4.3 cm", "hsv": "173,34,113:14,255,255"}),
    "disc": ("disc", {"diameter": "12 cm"}),
    "tag": ("tag", {"side": "16 cm", "family": "36h11"}),
}
READABLE_PX = 16.0
Outline = NDArray[np.float64]
Truth = Mapping[str, Any]


class Verdict(NamedTuple):
    """What became of one target by one method: found, wrong, missed; or of a room: nothing, perhaps, wrong."""

    row: str
    method: str
    said: str


def run(workers: int, folder: Path = PICTURES) -> Part:
    """Look for everything that is there."""
    title = "Found on real pictures"
    if not folder.is_dir():
        return Part(title=title, text="The real pictures are not on the machine that made this report.\n")
    jobs: list[tuple[str, Truth]] = []
    for kind in ("sheet", "ball", "tag", "empty"):
        jobs += ((kind, truth) for truth in json.loads((folder / kind / "truth.json").read_text(encoding="utf-8")))
    with ProcessPoolExecutor(workers) as pool:
        verdicts = [each for found in pool.map(partial(_judge, folder), jobs) for each in found]
    counts: dict[tuple[str, str], Counter[str]] = {}
    for each in verdicts:
        counts.setdefault((each.row, each.method), Counter())[each.said] += 1
    words, facts = _printed(folder / "distance")
    return Part(title=title, text=f"{_text(counts)}\n{words}", facts=_facts(counts) | facts)


def _printed(folder: Path) -> tuple[str, dict[str, float]]:
    """Measure A4 with a chessboard printed on it, on a robot's table, whose distance the board tells to 0.4 %."""
    truths = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    camera = load_camera_model(folder / "a4_printed.toml")
    finder = ours.detector("sheet", camera, width="297 mm", height="210 mm")
    errors = []
    for truth in truths:
        if truth["file"].startswith("a4_printed"):
            frame = ours.read(folder / truth["file"])
            errors.append(abs((finder.measure(frame).distance_m or math.inf) / truth["distance_m"] - 1))
    found = [each for each in errors if math.isfinite(each)]
    facts = {"real printed found": len(found) / len(errors), "real printed median": float(np.median(errors))}
    middle = f", median error {np.median(found):.2%}, largest {max(found):.2%}" if found else ""
    of_all = f"A4 with a chessboard printed on it, on a robot's table: {len(found)} of {len(errors)} measured{middle}."
    return f"{of_all}\n", facts


def _text(counts: Mapping[tuple[str, str], Counter[str]]) -> str:
    rows = list(dict.fromkeys(row for row, _ in counts))
    found = [
        (row, str(counts[row, "stadimeter"].total()), *(_cell(counts.get((row, method))) for method in METHODS))
        for row in rows
        if not row.startswith("room")
    ]
    rooms = [
        (
            row.removeprefix("room: "),
            *(str(counts[row, "stadimeter"][said]) for said in ("nothing", "perhaps", "wrong")),
        )
        for row in rows
        if row.startswith("room")
    ]
    return (
        f"Found / wrong / missed, on pictures that other people took; what is perhaps found counts. "
        f"{__doc__.split(chr(10) * 2)[1]}\n{table(('target', 'targets', *METHODS), found)}\n"
        f"Rooms without a target, in which is measured:\n\n{table(('target', 'nothing', 'perhaps', 'wrong'), rooms)}"
    )


def _cell(count: Counter[str] | None) -> str:
    return "–" if count is None else " / ".join(str(count[said]) for said in ("found", "wrong", "missed"))


def _facts(counts: Mapping[tuple[str, str], Counter[str]]) -> dict[str, float]:
    shares = {
        f"recall {row} {said}": count[said] / count.total()
        for (row, method), count in counts.items()
        if method == "stadimeter"
        for said in (("found", "wrong") if not row.startswith("room") else ("perhaps", "wrong"))
    }
    return {name: float(share) for name, share in shares.items()}


def _judge(folder: Path, job: tuple[str, Truth]) -> list[Verdict]:
    kind, truth = job
    cv2.setNumThreads(1)
    frame = ours.read(folder / kind / truth["file"])
    camera = CameraModel.with_focal_length(
        FOCAL_SHARE * max(frame.width_px, frame.height_px), frame.width_px, frame.height_px
    )

    def look(target: str, **options: Any) -> tuple[DetectionStatus, Points]:
        found = ours.detector(target, camera, **options).detect(frame)
        return found.status, found.outline_px

    if kind == "empty":
        return [_room(name, *look(target, **options)) for name, (target, options) in ROOMS.items()]
    return list(_JUDGES[kind](truth, frame.image, look))


def _room(name: str, status: DetectionStatus, _outline: Points) -> Verdict:
    said = {DetectionStatus.FOUND: "wrong", DetectionStatus.PERHAPS: "perhaps"}.get(status, "nothing")
    return Verdict(f"room: {name}", "stadimeter", said)


Look = Callable[..., tuple[DetectionStatus, Points]]


def _said(outline: Sequence[Any] | Points | None, is_true: Callable[[Any], bool]) -> str:
    if outline is None or not len(outline):
        return "missed"
    return "found" if is_true(outline) else "wrong"


def _sheet(truth: Truth, image: Image, look: Look) -> Iterator[Verdict]:
    width_m, height_m = truth["size_for_scoring_m"]
    is_true = partial(is_quad, truth["corners"])
    sides = {"width": f"{width_m} m", "height": f"{height_m} m"}
    box = tutorial.sheet_box(image)
    yield Verdict("sheets", "stadimeter", _said(look("sheet", **sides)[1], is_true))
    yield Verdict("sheets", "tutorial", _said(cv2.boxPoints(box) if box else None, is_true))
    yield Verdict(
        "sheets", "plain", _said(plain_sheet(image, max(width_m, height_m) / min(width_m, height_m)), is_true)
    )


def _ball(truth: Truth, image: Image, look: Look) -> Iterator[Verdict]:
    is_true = partial(is_circle, truth["circles"])
    size = {"diameter": f"{truth['size_known_m']} m"}
    yield Verdict("balls, no colour given", "stadimeter", _said(look("ball of any colour", **size)[1], is_true))
    yield Verdict("balls, no colour given", "plain", _said(plain_ball(image), is_true))
    if truth.get("hsv") and truth["file"] != truth.get("hsv_from"):
        row = "balls, by colour"
        yield Verdict(row, "stadimeter", _said(look("ball", **size, hsv=truth["hsv"])[1], is_true))
        low, high = (np.array([int(each) for each in part.split(",")]) for part in truth["hsv"].split(":"))
        yield Verdict(row, "tutorial", _said(_circle(tutorial.ball_circle(image, low, high)), is_true))


def _tag(truth: Truth, _image: Image, look: Look) -> Iterator[Verdict]:
    for number in sorted({tag["id"] for tag in truth["tags"]}):
        corners = [np.array(tag["corners"]) for tag in truth["tags"] if tag["id"] == number and tag["corners"]]
        sides_px = [math.sqrt(cv2.contourArea(each.astype(np.float32))) for each in corners]
        is_near = [
            lambda seen, true=each, side_px=side_px: math.dist(seen.mean(0), true.mean(0)) < 0.1 * side_px
            for each, side_px in zip(corners, sides_px, strict=True)
        ]
        is_large = max(sides_px, default=math.inf) >= READABLE_PX
        _, seen = look("tag", family=truth["family"], id=number)
        said = _said(seen, lambda outline, checks=is_near: not checks or any(check(outline) for check in checks))
        yield Verdict(f"tags {'of' if is_large else 'below'} {READABLE_PX:g} px", "stadimeter", said)


_JUDGES: dict[str, Callable[[Truth, Image, Look], Iterable[Verdict]]] = {"sheet": _sheet, "ball": _ball, "tag": _tag}


def is_quad(true: Sequence[Sequence[float]], seen: Sequence[Sequence[float]] | Points) -> bool:
    """Return whether four corners are those of the sheet, from whichever corner on."""
    if len(seen) != len(true):
        return False
    one, other = (_in_order(np.asarray(each, np.float64)) for each in (seen, true))
    reach_px = 0.1 * math.sqrt(cv2.contourArea(other.astype(np.float32)))
    sides = [np.hypot(*(np.roll(each, -1, axis=0) - each).T) for each in (one, other)]
    fits = [np.abs(np.roll(sides[0], turn) / sides[1] - 1).max() < 0.05 for turn in range(4)]
    return math.dist(one.mean(axis=0), other.mean(axis=0)) < reach_px and any(fits)


def _in_order(corners: Points) -> Points:
    across = corners - corners.mean(axis=0)
    return corners[np.argsort(np.arctan2(across[:, 1], across[:, 0]))]


def is_circle(circles: Sequence[Sequence[float]], rim: Sequence[Sequence[float]] | Points) -> bool:
    """Return whether points on a rim are those of one of the balls: x, y and radius of the circle through them."""
    points = np.asarray(rim, np.float64)
    left = np.column_stack([2 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(left, (points**2).sum(axis=1), rcond=None)[0]
    radius = math.sqrt(max(rest + x * x + y * y, 0.0))
    return any(
        math.hypot(x - u, y - v) < 0.2 * true and abs(radius / true - 1) < max(0.05, 1 / true) for u, v, true in circles
    )


def _circle(circle: tuple[float, float, float] | None) -> Points | None:
    if circle is None:
        return None
    turns = np.linspace(0, math.tau, 36, endpoint=False)
    return np.array(circle[:2]) + circle[2] * np.column_stack([np.cos(turns), np.sin(turns)])


def plain_sheet(image: Image, aspect: float) -> Points | None:
    """Return the four-sided region with the strongest edges all around: thresholds in some channels, and contours.

    Forty lines that anyone would write first; what looks like a sheet is never refused.
    """
    scale = 640 / max(image.shape[:2])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    channels = [
        *cv2.split(small),
        cv2.split(cv2.cvtColor(small, cv2.COLOR_BGR2HSV))[1],
        cv2.cvtColor(small, cv2.COLOR_BGR2GRAY),
    ]
    grey = cv2.GaussianBlur(channels[-1], (5, 5), 0).astype(np.float32)
    steep = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    best, best_support = None, 0.0
    for channel in channels:
        otsu = cv2.threshold(channel, 0, 255, cv2.THRESH_OTSU)[0]
        for limit in (otsu, *np.percentile(channel, (30, 50, 70, 85, 95))):
            for mask in (channel > limit, channel <= limit):
                contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
                for contour in contours:
                    quad = _four_corners(contour, aspect, small.shape)
                    if quad is None:
                        continue
                    ring = np.zeros(steep.shape, np.uint8)
                    cv2.polylines(ring, [quad.astype(np.int32)], isClosed=True, color=1, thickness=2)
                    support = float(np.median(steep[ring > 0])) * math.sqrt(cv2.contourArea(quad.astype(np.float32)))
                    if support > best_support:
                        best, best_support = quad / scale, support
    return best


def _four_corners(contour: NDArray[np.int32], aspect: float, shape: Sequence[int]) -> Points | None:
    hull = cv2.convexHull(contour)
    area = cv2.contourArea(hull)
    if not 0.002 < area / (shape[0] * shape[1]) < 0.9:
        return None
    quad = (
        cv2.approxPolyDP(hull, 0.03 * cv2.arcLength(hull, closed=True), closed=True).reshape(-1, 2).astype(np.float64)
    )
    if len(quad) != 4:
        return None
    sides = np.hypot(*(np.roll(quad, -1, axis=0) - quad).T)
    one, other = sides[0] + sides[2], sides[1] + sides[3]
    return quad if 0.6 < max(one, other) / min(one, other) / aspect < 1.6 else None


def plain_ball(image: Image) -> Points | None:
    """Return the rim of the circle of OpenCV's Hough transform with the most contrast around it."""
    scale = 640 / max(image.shape[:2])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = cv2.medianBlur(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), 5)
    circles = cv2.HoughCircles(grey, cv2.HOUGH_GRADIENT, 1.5, 15, param1=120, param2=30, minRadius=6, maxRadius=240)
    if circles is None:
        return None
    smooth = cv2.GaussianBlur(small, (5, 5), 0).astype(np.float32)

    def contrast(circle: NDArray[np.float32]) -> float:
        rings = [_circle((circle[0], circle[1], share * circle[2])) for share in (0.8, 1.2)]
        inside, outside = (
            cv2.remap(smooth, ring[:, :1].astype(np.float32), ring[:, 1:].astype(np.float32), cv2.INTER_LINEAR)
            for ring in rings
            if ring is not None
        )
        return float(np.percentile(np.abs(inside - outside).sum(axis=-1), 20))

    x, y, radius = (float(each) / scale for each in max(circles[0], key=contrast))
    return _circle((x, y, radius))
