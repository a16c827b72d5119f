"""What ``measure`` prints: a line or a JSON object for each target, and for how far two of them are apart."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import typer

from stadimeter.cli.explanation import explanation, explanation_record
from stadimeter.cli.formatting import METRE, LengthUnit, format_bearing, format_distance, format_position, format_tilt
from stadimeter.cli.target_options import WantedTargets
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.ranging.separation import Separation
from stadimeter.workbench.measuring import PictureResult, TargetResult


class Printer(Protocol):
    """Prints results on standard output, and what is wrong on standard error."""

    def result(self, result: TargetResult) -> None:
        """Print what became of one target."""
        ...

    def separation(self, result: PictureResult, names: tuple[str, str], found: Separation | None) -> None:
        """Print how far apart two targets are."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class _JsonPrinter:
    explain: bool

    def result(self, result: TargetResult) -> None:
        further = explanation_record(result) if self.explain else {}
        typer.echo(json.dumps({**result.record(), **further}))
        _tell_error(result)

    def separation(self, result: PictureResult, names: tuple[str, str], found: Separation | None) -> None:
        place = result.targets[0]
        record = {
            "file": result.file,
            "between": names,
            "distance_m": found and found.distance_m,
            "sigma_m": found and found.sigma_m,
            "frame": place.frame,
            "time_s": place.time_s,
        }
        typer.echo(json.dumps(record))


@dataclass(frozen=True, slots=True, kw_only=True)
class _LinePrinter:
    unit: LengthUnit
    file_width: int
    target_width: int
    explain: bool

    def result(self, result: TargetResult) -> None:
        if not _tell_error(result):
            typer.echo(f"{self._head(result, result.label)}  {_in_words(result, self.unit)}")
            for line in explanation(result) if self.explain else ():
                typer.echo(line)

    def separation(self, result: PictureResult, names: tuple[str, str], found: Separation | None) -> None:
        words = "unknown: not both are measured"
        if found is not None:
            words = format_distance(found.distance_m, found.sigma_m, self.unit)
            if self.unit is not METRE:
                words += f"  {format_distance(found.distance_m, found.sigma_m, METRE)}"
        typer.echo(f"{self._head(result.targets[0], ' to '.join(names))}  {words}")

    def _head(self, result: TargetResult, label: str) -> str:
        place = "" if result.time_s is None else f"  frame {result.frame:>4}  {result.time_s:8.3f} s"
        return f"{result.file:<{self.file_width}}{place}  {label:<{self.target_width}}"


def printer_of(names: Sequence[str], wanted: WantedTargets, *, as_json: bool, explain: bool) -> Printer:
    """Return what prints results for inputs of these names: as JSON, or as lines in the person's unit."""
    if as_json:
        return _JsonPrinter(explain=explain)
    return _LinePrinter(
        unit=wanted.unit,
        file_width=max(map(len, names)),
        target_width=max(len(choice.name) for choice in wanted.choices),
        explain=explain,
    )


def _tell_error(result: TargetResult) -> bool:
    """Tell a bad picture on standard error; return whether it is one."""
    is_error = result.measurement.status is MeasurementStatus.ERROR
    if is_error:
        reason = result.measurement.reason
        where = "" if result.file in reason else f"{result.file}: "
        typer.echo(f"error: {where}{reason}", err=True)
    return is_error


def _in_words(result: TargetResult, unit: LengthUnit) -> str:
    measured = result.measurement
    if measured.status is not MeasurementStatus.MEASURED:
        status = "truncated" if measured.status is MeasurementStatus.TRUNCATED else "not found"
        return f"{status}: {measured.reason}"
    in_metres = format_distance(measured.distance_m, measured.sigma_m, METRE)
    first = "" if unit is METRE else f"{format_distance(measured.distance_m, measured.sigma_m, unit):<15} "
    depth = format_distance(measured.depth_m, measured.sigma_m, unit)
    position = format_position(measured.position_m, measured.sigma_m, unit)
    bearing, tilt = format_bearing(measured.bearing_rad), format_tilt(measured.tilt_rad)
    whereabouts = f"{position:<23} {bearing:<10} {tilt}".rstrip()
    return f"{first}{in_metres:<17} depth {depth:<17} {whereabouts}"
