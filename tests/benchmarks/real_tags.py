"""Real tags: one picture with known poses, and one tag turned to all sides at the same distance."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import ours
from part import Part, table

from stadimeter.core.camera_model import CameraModel

VISP_SIDE_M, VISP_FOCAL_PX, VISP_CENTRE_PX = 0.053, 615.17, (312.19, 243.44)
DUCKIE_SIDE_M, DUCKIE_FOCAL_PX, DUCKIE_CENTRE_PX = 0.065, (329.873, 332.946), (528.0, 396.0)


def visp(folder: Path) -> Part:
    """Measure twelve tags in one picture, beside poses that ViSP computed.

    Args:
        folder: Where the picture is.

    Returns:
        A part of the report.
    """
    title = "Twelve AprilTags (ViSP)"
    if not ours.exists("tag"):
        return Part(title=title, text="There is no detector for tags yet.\n")
    frame = ours.read(folder / "AprilTag.png")
    camera = _camera(frame.width_px, frame.height_px, (VISP_FOCAL_PX, VISP_FOCAL_PX), VISP_CENTRE_PX)
    rows, errors = [], []
    for number, known_m in _known_ranges_m(folder / "ground_truth_pose.txt").items():
        finder = ours.detector("tag", camera, side=f"{VISP_SIDE_M} m", id=number)
        measured = ours.measure(finder, frame.image)
        if measured.distance_m is None:
            rows.append((str(number), f"{known_m:.4f}", "–", measured.reason))
            continue
        errors.append(measured.distance_m / known_m - 1)
        sigma = f"± {measured.sigma_m:.4f}"
        rows.append((str(number), f"{known_m:.4f}", f"{measured.distance_m:.4f} {sigma}", f"{100 * errors[-1]:+.2f}"))
    facts = {"real visp found": float(len(errors))}
    if errors:
        facts["real visp median"] = float(np.median(np.abs(errors)))
    return Part(title=title, text=table(("tag", "reference m", "measured m", "error %"), rows), facts=facts)


def duckietown(folder: Path) -> Part:
    """Measure one tag that is turned to the left and to the right; its distance is always the same.

    Args:
        folder: Where the pictures are.

    Returns:
        A part of the report.
    """
    title = "One AprilTag, turned (Duckietown)"
    if not ours.exists("tag"):
        return Part(title=title, text="There is no detector for tags yet.\n")
    rows, ranges = [], []
    for path in sorted(folder.glob("*.png"), key=_angle_deg):
        frame = ours.read(path)
        camera = _camera(frame.width_px, frame.height_px, DUCKIE_FOCAL_PX, DUCKIE_CENTRE_PX)
        measured = ours.measure(ours.detector("tag", camera, side=f"{DUCKIE_SIDE_M} m"), frame.image)
        if measured.distance_m is None:
            rows.append((f"{_angle_deg(path)}°", measured.reason))
        else:
            ranges.append(measured.distance_m)
            rows.append((f"{_angle_deg(path)}°", f"{measured.distance_m:.4f} ± {measured.sigma_m:.4f}"))
    missed = len(rows) - len(ranges)
    spread = max(abs(each / float(np.mean(ranges)) - 1) for each in ranges) if ranges and not missed else float("inf")
    text = table(("turned by", "measured m"), rows)
    return Part(title=title, text=text, facts={"real duckietown spread": spread})


def _camera(
    width_px: int, height_px: int, focal_px: tuple[float, float], centre_px: tuple[float, float]
) -> CameraModel:
    return CameraModel(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px[0],
        fy_px=focal_px[1],
        cx_px=centre_px[0],
        cy_px=centre_px[1],
    )


def _known_ranges_m(path: Path) -> dict[int, float]:
    """Return the range of each tag by its number: a line with its name, then one with its pose, position first."""
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    numbers = [int(re.search(r"_(\d+)$", line)[1]) for line in lines[::2]]
    positions = [np.array(line.split()[:3], float) for line in lines[1::2]]
    return {number: float(np.linalg.norm(position)) for number, position in zip(numbers, positions, strict=True)}


def _angle_deg(path: Path) -> int:
    return int(path.stem.rsplit("_", 1)[1])
