"""Output of ``measure``: lines or JSON objects for targets, ``--explain``, ``--between``, and annotated copies."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

import typer
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.cli.exits import make_folder, say_note
from stadimeter.cli.formatting import (
    METRE,
    LengthUnit,
    format_bearing,
    format_distance,
    format_place,
    format_position,
    format_tilt,
)
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.measure import Separation, SigmaParts
from stadimeter.workbench.annotation import Mark
from stadimeter.workbench.measuring import PictureResult, TargetResult


class Printer(Struct, frozen=True, kw_only=True):
    """Prints results on standard output, as JSON or as lines in the person's unit; what is wrong on standard error."""

    as_json: bool
    explain: bool
    unit: LengthUnit
    file_width: int
    target_width: int

    def result(self, result: TargetResult) -> None:
        """Print what became of one target in a picture."""
        if self.as_json:
            typer.echo(json.dumps(result.record() | (explanation_record(result) if self.explain else {})))
        if _print_error(result) or self.as_json:
            return
        typer.echo(f"{self._head(result, result.label)}  {_in_words(result, self.unit)}")
        if result.note:
            say_note(f"{result.file}: {result.note}")
        for line in explanation(result) if self.explain else ():
            typer.echo(line)

    def separation(self, result: PictureResult, names: tuple[str, str], found: Separation | None) -> None:
        """Print how far apart two targets of a picture are."""
        place = result.targets[0]
        distance_m, sigma_m = (found.distance_m, found.sigma_m) if found is not None else (None, None)
        if self.as_json:
            record = {"file": result.file, "between": names, "distance_m": distance_m, "sigma_m": sigma_m}
            typer.echo(json.dumps({**record, "frame": place.frame, "time_s": place.time_s}))
            return
        units = dict.fromkeys((self.unit, METRE))
        words = "  ".join(format_distance(distance_m, sigma_m, unit) for unit in units)
        if found is None:
            words = "unknown: not both are measured"
        typer.echo(f"{self._head(place, ' to '.join(names))}  {words}")

    def _head(self, result: TargetResult, label: str) -> str:
        place = "" if result.time_s is None else f"  frame {result.frame:>4}  {result.time_s:8.3f} s"
        return f"{result.file:<{self.file_width}}{place}  {label:<{self.target_width}}"


def _print_error(result: TargetResult) -> bool:
    """Tell a bad picture on standard error; return whether it is one."""
    is_error = result.measurement.status is MeasurementStatus.ERROR
    if is_error:
        reason = result.measurement.reason
        where = "" if result.file in reason else f"{result.file}: "
        typer.echo(f"error: {where}{reason}", err=True)
    return is_error


def _in_words(result: TargetResult, unit: LengthUnit) -> str:
    measured = result.measurement
    in_metres = format_distance(measured.distance_m, measured.sigma_m, METRE)
    first = "" if unit is METRE else f"{format_distance(measured.distance_m, measured.sigma_m, unit):<15} "
    if measured.status is MeasurementStatus.PERHAPS:
        return f"perhaps {first}{in_metres}: {measured.reason}"
    if measured.status is not MeasurementStatus.MEASURED:
        status = "truncated" if measured.status is MeasurementStatus.TRUNCATED else "not found"
        return f"{status}: {measured.reason}"
    depth = format_distance(measured.depth_m, measured.sigma_m, unit)
    position = format_position(measured.position_m, measured.sigma_m, unit)
    bearing, tilt = format_bearing(measured.bearing_rad), format_tilt(measured.tilt_rad)
    whereabouts = f"{position:<23} {bearing:<10} {tilt}".rstrip()
    return f"{first}{in_metres:<17} depth {depth:<17} {whereabouts}"


INDENT = 4
LABEL_WIDTH = 11

# From this ambiguity on it is said that another tilt explains the picture nearly as well.
UNSURE = 0.5

# A smaller share of the distance is written as no uncertainty.
_NO_SHARE = 5e-6


def explanation(result: TargetResult) -> list[str]:
    """Explain in lines what became of a target in a picture; none for a picture that could not be read."""
    found = result.detection
    if found is None:
        return []
    is_there = found.status is not DetectionStatus.NOT_FOUND
    seen = [*_found_lines(found, _by_size(result), result.parts), *_floor_lines(result)] if is_there else []
    return [
        f"{'':<{INDENT}}{label:<{LABEL_WIDTH}}{words}"
        for label, words in (*seen, *result.more(), *_rejected_lines(result, found))
    ]


def _by_size(result: TargetResult) -> Measurement:
    return result.measurement if result.floor is None else result.floor.by_size


def _floor_lines(result: TargetResult) -> list[tuple[str, str]]:
    """Say what the floor tells of a target that is on it, and what became of size and floor together."""
    floor = result.floor
    if floor is None or result.parts is None:
        return []
    by_floor = "above the horizon" if floor.distance_m is None else format_distance(floor.distance_m, floor.sigma_m)
    both = format_distance(result.measurement.distance_m, result.measurement.sigma_m)
    size = format_distance(floor.by_size.distance_m, floor.by_size.sigma_m)
    lines = [("floor", f"{by_floor} by the floor, {size} by its size, {floor.apart_sigmas:.1f} σ apart; taken: {both}")]
    return [*lines, *([("remark", floor.measurement.reason)] if floor.measurement.reason else [])]


def explanation_record(result: TargetResult) -> dict[str, object]:
    """Return `explanation` as further fields of the object that ``--json`` prints, in metres and pixels."""
    found, parts = result.detection, result.parts
    seen = found if found is not None and found.status is not DetectionStatus.NOT_FOUND else None
    return {
        "remark": found.reason if found is not None and parts is not None else "",
        "centre_px": [_number(each) for each in seen.centre_px] if seen else None,
        "width_px": _number(seen.width_px) if seen else None,
        "height_px": _number(seen.height_px) if seen else None,
        "size_sigma_px": _number(seen.size_sigma_px) if seen else None,
        "quality": _number(seen.quality) if seen else None,
        "sigma_edges_m": _number(parts.edges_m) if parts else None,
        "sigma_focal_length_m": _number(parts.focal_length_m) if parts else None,
        "sigma_size_m": _number(parts.size_m) if parts else None,
        "sigma_pose_m": _number(parts.pose_m) if parts else None,
        "floor_distance_m": result.floor.distance_m if result.floor else None,
        "floor_sigma_m": _number(result.floor.sigma_m) if result.floor else None,
        "floor_apart_sigmas": _number(result.floor.apart_sigmas) if result.floor else None,
        "rejected": [_rejected_record(number, each) for number, each in result.rejected],
    }


def _rejected_record(number: int, candidate: RejectedCandidate) -> dict[str, object]:
    return {
        "number": number,
        "centre_px": [_number(each) for each in candidate.centre_px],
        "size_px": _number(candidate.size_px),
        "reason": candidate.reason,
    }


def _number(value: float) -> float | None:
    """Return a number that JSON can hold; None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def _found_lines(found: Detection, measured: Measurement, parts: SigmaParts | None) -> list[tuple[str, str]]:
    lines = []
    if found.width_px > 0:
        size = f"{found.width_px:.2f} x {found.height_px:.2f} px ± {found.size_sigma_px:.2f}"
        x, y = found.centre_px
        lines.append(("seen", f"{size} at {x:.1f}, {y:.1f}, quality {found.quality:.2f}"))
    if measured.tilt_rad is not None:
        lines.append(("tilt", f"{format_tilt(measured.tilt_rad)}{_mirrored_words(measured)}"))
    if parts is not None:
        lines.append(("sigma", _sigma_in_words(measured, parts)))
        if found.reason:
            lines.append(("remark", found.reason))
    return lines


def _mirrored_words(measured: Measurement) -> str:
    if measured.ambiguity is None:
        return ""
    figure = f"{measured.ambiguity:.2f}"
    if measured.ambiguity >= UNSURE:
        return f", or mirrored: both explain the picture nearly alike (ambiguity {figure}, 1 is no idea)"
    return f", ambiguity {figure}"


def _sigma_in_words(measured: Measurement, parts: SigmaParts) -> str:
    distance_m = measured.distance_m or math.inf
    is_flat = measured.tilt_rad is not None
    named = [("edges", parts.edges_m), ("focal length", parts.focal_length_m), ("size", parts.size_m)]
    if parts.pose_m >= _NO_SHARE * distance_m:
        named.append(("which way it is tilted" if is_flat else "other causes", parts.pose_m))
    causes = ", ".join(f"{name} {_share(sigma_m / distance_m)}" for name, sigma_m in named)
    return f"{_share((measured.sigma_m or 0.0) / distance_m)} of the distance: {causes}"


def _share(share: float) -> str:
    if share < _NO_SHARE:
        return "taken as exact"
    return f"{100 * share:.3f} %" if share < 0.001 else f"{100 * share:.2f} %"


def _rejected_lines(result: TargetResult, found: Detection) -> list[tuple[str, str]]:
    if not found.rejected:
        return [("rejected", "nothing else was looked at" if len(found.outline_px) else "nothing was looked at")]
    number_width = len(str(result.rejected[-1][0]))
    places = [format_place(candidate) for candidate in found.rejected]
    place_width = max(map(len, places))
    return [
        ("" if index else "rejected", f"{number:>{number_width}}  {place:<{place_width}}  {candidate.reason}")
        for index, ((number, candidate), place) in enumerate(zip(result.rejected, places, strict=True))
    ]


# A copy is of the same kind as the picture where that is one of these, else a PNG.
KEPT_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}

# Characters of a target's name beside it in an annotated copy, and of a line of its reason.
MAX_NAME, WRAPPED_AT = 24, 64

_WORDS = {
    MeasurementStatus.NOT_FOUND: "not found",
    MeasurementStatus.TRUNCATED: "cut off by the border",
    MeasurementStatus.ERROR: "no measurement",
}


def copy_paths(images: Sequence[Path], folder: Path | None, ending: str = "measured") -> dict[Path, Path]:
    """Choose a file for the copy of each picture, such as ``3ft-measured.png``; two pictures of one name get two.

    No copy has the name of its picture, so that the folder may be the pictures' own.

    Raises:
        ConfigError: The folder cannot be made.
    """
    if folder is None:
        return {}
    make_folder(folder, "--annotate")
    paths: dict[Path, Path] = {}
    for image in dict.fromkeys(images):
        suffix = image.suffix if image.suffix.lower() in KEPT_SUFFIXES else ".png"
        taken = set(paths.values()) | set(images)
        names = (
            f"{image.stem}-{ending}{number}{suffix}" for number in ("", *(f"-{n}" for n in range(2, len(images) + 3)))
        )
        paths[image] = next(folder / name for name in names if folder / name not in taken)
    return paths


# How many of what was rejected are drawn, the most like the target: more hide the picture.
DRAWN_MAX = 3


def marks_of(result: PictureResult, unit: LengthUnit, *, explain: bool = False) -> tuple[Mark, ...]:
    """Return the marks for the copy of a picture; with ``explain``, also edge points and the best of the rest."""
    marks = (_mark(each, unit) for each in result.targets)
    if not explain:
        return tuple(marks)
    return tuple(
        replace(mark, edges_px=each.find_edges(), rejected=each.rejected[:DRAWN_MAX])
        for mark, each in zip(marks, result.targets, strict=True)
    )


def _mark(result: TargetResult, unit: LengthUnit) -> Mark:
    measured = result.measurement
    detection = result.detection or Detection(target=measured.target, status=DetectionStatus.NOT_FOUND)
    name = result.label if len(result.label) <= MAX_NAME else f"{result.label[: MAX_NAME - 2]}.."
    if measured.status in (MeasurementStatus.MEASURED, MeasurementStatus.PERHAPS):
        words, lines = format_distance(measured.distance_m, measured.sigma_m, unit), tuple[str, ...]()
        if measured.status is MeasurementStatus.PERHAPS:
            words, lines = f"perhaps {words}", (*textwrap.wrap(f"perhaps: {measured.reason}", WRAPPED_AT),)
    else:
        words = _WORDS[measured.status]
        lines = (f"{result.label}: {words}", *textwrap.wrap(measured.reason, WRAPPED_AT))
    return Mark(detection=detection, has_corners=result.has_corners, headline=f"{name}: {words}", lines=lines)
