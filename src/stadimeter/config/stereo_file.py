"""The stereo file: two cameras, where the right one is, and how well that is known, as a TOML text."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec.structs import replace
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from stadimeter.config.camera_file import CameraModelTable, Correlation, camera_file_text, date_text, save_as
from stadimeter.config.findings import Finding, findings_of, problems
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.toml_source import Texts, as_toml, read_toml
from stadimeter.config.untrusted_file import CAMERA_FILE_MAX_BYTES
from stadimeter.core.camera_model import CameraModel, Provenance, are_contradictory, join_covariance, split_covariance
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties
from stadimeter.errors import CalibrationError, ConfigError, Problem

_HOW_TO_MAKE_ONE = "make it with `stadimeter calibrate stereo LEFT/*.jpg RIGHT/*.jpg --board 9x6 --square 25mm -o FILE`"
_PAIRS = UNKNOWNS * (UNKNOWNS - 1) // 2

# Cameras that are further apart are no stereo camera, and a rotation vector is no longer than half a turn.
_PLACE_MAX_M, _TURN_MAX_RAD = 100.0, 3.15

Metre = Annotated[float, Field(ge=-_PLACE_MAX_M, le=_PLACE_MAX_M, strict=True)]
Radian = Annotated[float, Field(ge=-_TURN_MAX_RAD, le=_TURN_MAX_RAD, strict=True)]
Sigma = Annotated[float, Field(ge=0, strict=True)]


class StereoFileTable(BaseModel):
    """A stereo file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    turn_rad: tuple[Radian, Radian, Radian]
    """How the right camera is turned, as a rotation vector in the left one's frame."""
    place_m: tuple[Metre, Metre, Metre]
    """Where the right camera is in the left one's frame: x to the right, y down, z forward."""
    sigmas: Annotated[tuple[Sigma, ...], Field(min_length=UNKNOWNS, max_length=UNKNOWNS)]
    """Standard deviations of nine parameters of the left lens, of the right lens, of the turn and of the place."""
    correlations: Annotated[tuple[Correlation, ...], Field(min_length=_PAIRS, max_length=_PAIRS)]
    """Their correlations, row by row above the diagonal."""
    method: str = ""
    """How it was made."""
    date: Annotated[str, BeforeValidator(date_text)] = ""
    """When, as an ISO 8601 date."""
    notes: tuple[str, ...] = ()
    """The figures that it came from, one a line."""
    left: CameraModelTable
    """The left camera, as a camera file has it."""
    right: CameraModelTable
    """The right camera."""

    def to_rig(self) -> StereoRig:
        """Return the two cameras; raises CalibrationError if there are none with these values."""
        if are_contradictory(self.correlations, UNKNOWNS):
            raise CalibrationError("the correlations contradict each other; calibrate again", "correlations")
        rig = StereoRig(
            left=self.left.to_model(),
            right=self.right.to_model(),
            turn_rad=self.turn_rad,
            place_m=self.place_m,
            covariance=join_covariance(self.sigmas, self.correlations),
            provenance=Provenance(method=self.method, date=self.date, notes=self.notes),
        )
        return with_uncertainties(rig)


def load_stereo_rig(path: Path, texts: Texts | None = None) -> StereoRig:
    """Read a stereo file.

    Args:
        texts: What to read in place of files.

    Raises:
        ConfigError: It lists everything that is wrong, each with its line where that is known.
    """
    source = read_toml(path, CAMERA_FILE_MAX_BYTES, missing_hint=_HOW_TO_MAKE_ONE, texts=texts)
    if "fx_px" in source.table:
        raise ConfigError([Problem("this is a camera file, of one camera", str(path), hint=_HOW_TO_MAKE_ONE)])
    return _rig(source.table, str(path), source.spans)


def _rig(table: Mapping[str, Any], file: str, spans: Mapping[KeyPath, SourceSpan]) -> StereoRig:
    try:
        return StereoFileTable.model_validate(dict(table)).to_rig()
    except ValidationError as error:
        raise ConfigError(problems(findings_of(error, StereoFileTable, table, ()), file, spans)) from error
    except CalibrationError as error:
        raise ConfigError(problems([Finding((error.key,), str(error), code="bad-value")], file, spans)) from error


def save_stereo_rig(path: Path, rig: StereoRig) -> None:
    """Write or replace a stereo file, or leave what was there as it was; see `save_as`."""
    save_as(path, stereo_file_text(rig), "stereo file")


def stereo_file_text(rig: StereoRig) -> str:
    """Return a stereo file that `load_stereo_rig` reads as the same cameras."""
    sigmas, correlations = split_covariance(rig.covariance)
    rows, left = "", [float(f"{each:.10g}") for each in correlations]
    for count in range(UNKNOWNS - 1, 0, -1):
        rows += f"    {', '.join(map(repr, left[:count]))},\n"
        left = left[count:]
    notes = "".join(f"    {as_toml(note)},\n" for note in rig.provenance.notes)
    return f"""\
# Two cameras for stadimeter: {rig.baseline_m:.4f} m apart.

# How the right camera is turned in the frame of the left one, as a rotation vector, and where it is: x to the right,
# y down, z forward.
turn_rad = {list(rig.turn_rad)!r}
place_m = {list(rig.place_m)!r}

# Standard deviations of fx, fy, cx, cy, k1, k2, p1, p2 and k3 of the left camera, of the right one, of turn_rad and of
# place_m; and their correlations, row by row above the diagonal.
sigmas = {_figures(sigmas)}
correlations = [
{rows}]

method = {as_toml(rig.provenance.method)}
date = {as_toml(rig.provenance.date)}

# The reprojection error of each pair.
notes = [
{notes}]

[left]
{_table(rig.left, "left")}
[right]
{_table(rig.right, "right")}"""


def _figures(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{each:.9g}' for each in np.asarray(values, np.float64) + 0.0)}]"


def _table(model: CameraModel, name: str) -> str:
    """Return a camera as a table; what is known of its lens stands in the covariance of both."""
    text = camera_file_text(replace(model, uncertainty=None)).partition("\n")[2]
    return text.replace("\n[optics]\n", f"\n[{name}.optics]\n")
