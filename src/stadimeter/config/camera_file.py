"""The camera file and the stereo file: camera models as small TOML texts. And what a picture says of its camera."""

from __future__ import annotations

import datetime as dt
import json
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import to_builtins
from msgspec.structs import replace
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from stadimeter.config.files import CAMERA_FILE_MAX_BYTES, read_untrusted, write_atomically
from stadimeter.config.findings import Finding, findings_of, problems
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.toml_source import Texts, as_toml, read_toml
from stadimeter.core.camera_model import (
    PARAMETERS,
    UNKNOWN_EDGE_BIAS_SIGMA_PX,
    CameraModel,
    LensUncertainty,
    Medium,
    Provenance,
    ToneCurve,
    are_contradictory,
    behind_flat_port,
    join_covariance,
    split_covariance,
)
from stadimeter.core.frame import Optics, Subsampling
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties
from stadimeter.errors import CalibrationError, ConfigError, Problem, UnreadableError, reason_of

# The camera file: a camera model as a small TOML text. And what a picture file says of the camera that took it --------

# Ten times as many as any camera has.
MAX_PIXELS_ACROSS = 100_000

# Cameras have some tenths of a pixel; with more than this, small targets would have no size left.
MAX_EDGE_BIAS_PX = 5.0

# A window further from the lens is no window of a housing.
MAX_PORT_M = 0.5


# How the camera was set that took a picture is kept in the picture: in a PNG, as a chunk of text behind its header.
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_BYTES = 33
_OPTICS = b"stadimeter-optics\0"
_OPTICS_CHUNK = re.compile(rb"(.{4})tEXt" + _OPTICS + rb"(\{[ -~]{1,1000}\})", re.DOTALL)

# The hint where there is no camera file.
HOW_TO_MAKE_ONE = "make it with `stadimeter calibrate distance PICTURE@DISTANCE -o FILE`"


def date_text(value: object) -> object:
    """Return a date of TOML as text, and anything else as it is."""
    return value.isoformat() if isinstance(value, dt.date) else value


Pixels = Annotated[int, Field(gt=0, le=MAX_PIXELS_ACROSS, strict=True)]
PixelsOrZero = Annotated[int, Field(ge=0, le=MAX_PIXELS_ACROSS, strict=True)]
FocalPixels = Annotated[float, Field(gt=0, strict=True)]
CentrePixels = Annotated[float, Field(strict=True)]
Coefficient = Annotated[float, Field(strict=True)]
SigmaOfParameter = Annotated[float, Field(ge=0, strict=True)]
Correlation = Annotated[float, Field(ge=-1, le=1, strict=True)]
LensSetting = Annotated[float, Field(gt=0)] | str


class OpticsTable(BaseModel):
    """The camera's settings when it was calibrated, as far as they change its focal length in pixels."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    sensor: str
    """The name of the image sensor."""
    sensor_size_px: tuple[Pixels, Pixels]
    """Width and height of the sensor's mode."""
    crop_px: tuple[PixelsOrZero, PixelsOrZero, Pixels, Pixels]
    """The part of the sensor that fills the picture: left, top, width and height in the sensor's own pixels."""
    lens_position_dpt: Annotated[float, Field(ge=0, strict=True)] | None = None
    """Where the lens stands, in dioptres; None for one that is turned by hand, or that moves."""
    upside_down: bool = False
    """Whether the picture was turned by half a turn."""

    def to_optics(self) -> Optics:
        """Return the same for the core."""
        return Optics(**self.model_dump())


class CameraModelTable(BaseModel):
    """A camera file, or a ``model`` table in a configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    width_px: Pixels
    """Width of the pictures that it is for."""
    height_px: Pixels
    """Height of the pictures that it is for."""
    fx_px: FocalPixels
    """Focal length in pixels, horizontally."""
    fy_px: FocalPixels | None = None
    """Focal length in pixels, vertically; None for square pixels."""
    cx_px: CentrePixels | None = None
    """Where the optical axis meets the picture, horizontally; None for the middle."""
    cy_px: CentrePixels | None = None
    """The same, vertically."""
    distortion: tuple[Coefficient, ...] = ()
    """k1, k2, p1, p2 and perhaps k3 as OpenCV has them; none for a lens that does not bend lines."""
    tone_curve: ToneCurve = "srgb"
    """How code values follow from light: as in sRGB, or in proportion to it."""
    edge_bias_px: Annotated[float, Field(ge=-MAX_EDGE_BIAS_PX, le=MAX_EDGE_BIAS_PX, strict=True)] = 0.0
    """How far outwards each edge of a bright target is measured."""
    edge_bias_sigma_px: Annotated[float, Field(ge=0, le=MAX_EDGE_BIAS_PX, strict=True)] = 0.0
    """Its standard deviation: 0.1 for a camera of whose tone curve and sharpening nothing is known. Where it is not
    stated it is that in a camera file, and 0 in a table of a configuration, which is for worlds and their cameras."""
    focal_relative_sigma: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """Standard deviation of the focal length, as a share of it."""
    lens_sigmas: tuple[SigmaOfParameter, ...] = ()
    """Standard deviations of fx, fy, cx and cy in pixels, of k1, k2, p1, p2 and k3; none where they are not known."""
    lens_correlations: tuple[Correlation, ...] = ()
    """The correlations of these, row by row above the diagonal of their matrix: 36 numbers."""
    subsampling: Subsampling | None = None
    """How coarsely the camera stores colour: for every pixel (``"4:4:4"``), every second one across (``"4:2:2"``), or
    across and down (``"4:2:0"``). None leaves it to the driver: a JPEG file says it, MJPEG and video count as 4:2:0."""
    method: str = ""
    """How the camera was calibrated."""
    date: Annotated[str, BeforeValidator(date_text)] = ""
    """When, as an ISO 8601 date."""
    notes: tuple[str, ...] = ()
    """The figures that it came from, one a line."""
    taken_with: dict[Literal["focal_length_mm", "equivalent_mm", "digital_zoom", "lens"], LensSetting] = {}
    """How the lens was set, as the pictures' EXIF data state it; other pictures are compared with it."""
    medium: Medium = "air"
    """What the camera looks into through a flat window: ``"water"`` or ``"sea water"``, if it was calibrated in air."""
    port_m: Annotated[float, Field(ge=0, le=MAX_PORT_M, strict=True)] = 0.0
    """In metres; how far that window is in front of the lens."""
    optics: OpticsTable | None = None
    """How the camera was set. A run on a camera that knows its settings, and has others, is refused."""

    def to_model(self) -> CameraModel:
        """Return the camera model; raises CalibrationError if there is none with these values."""
        beside = {"lens_sigmas", "lens_correlations", "optics", "medium", "port_m", *Provenance.__struct_fields__}
        given = self.model_dump(exclude=beside, exclude_none=True)
        centre = {"cx_px": (self.width_px - 1) / 2, "cy_px": (self.height_px - 1) / 2}
        in_air = CameraModel(
            **{"fy_px": self.fx_px, **centre, **given},
            optics=None if self.optics is None else self.optics.to_optics(),
            uncertainty=self._uncertainty(),
            provenance=Provenance(
                method=self.method, date=self.date, notes=self.notes, taken_with=tuple(self.taken_with.items())
            ),
        )
        return behind_flat_port(in_air, self.medium, self.port_m)

    def _uncertainty(self) -> LensUncertainty | None:
        if not (self.lens_sigmas or self.lens_correlations):
            return None
        return LensUncertainty(sigmas=self.lens_sigmas, correlations=self.lens_correlations)


def camera_model_from_table(table: Mapping[str, Any]) -> CameraModel:
    """Make a camera model from a table of a configuration, which holds the same keys as a camera file.

    Raises:
        ConfigError: It lists every key that is wrong, without file and line.
    """
    return _model(table, "", {})


def load_camera_model(path: Path, texts: Texts | None = None) -> CameraModel:
    """Read a camera file. One that does not say how well its edge bias is known is not sure of it.

    Raises:
        ConfigError: It lists everything that is wrong, each with its line where that is known.
    """
    if (foreign := _foreign_table(path, texts)) is not None:
        return _model(foreign, str(path), {})
    source = read_toml(path, CAMERA_FILE_MAX_BYTES, missing_hint=HOW_TO_MAKE_ONE, texts=texts)
    return _model({"edge_bias_sigma_px": UNKNOWN_EDGE_BIAS_SIGMA_PX, **source.table}, str(path), source.spans)


def _foreign_table(path: Path, texts: Texts | None) -> dict[str, Any] | None:
    """Return the camera file that says the same as a calibration file of another program; None if it is none."""
    from stadimeter.config import other_calibrations  # noqa: PLC0415 - most only read camera files of their own

    try:
        text = (texts or {}).get(path) or read_untrusted(path, CAMERA_FILE_MAX_BYTES).decode("latin-1")
        return other_calibrations.camera_table(text)
    except UnreadableError:
        return None  # said where it is read as TOML
    except ValueError as error:
        words = f"this calibration file of another program cannot be used: {error}"
        raise ConfigError([Problem(words, str(path), hint=HOW_TO_MAKE_ONE, code="bad-value")]) from error


def save_camera_model(path: Path, model: CameraModel) -> None:
    """Write or replace a camera file, or leave what was there as it was: never half a file; see `save_as`."""
    save_as(path, camera_file_text(model), "camera file")


def save_as(path: Path, text: str, what: str) -> None:
    """Write or replace a file that a calibration made, or leave what was there as it was.

    Raises:
        ConfigError: It cannot be written there.
    """
    try:
        write_atomically(path, text.encode(errors="replace"))  # a picture's name need not be text
    except OSError as error:
        message = f"the {what} cannot be written: {reason_of(error)}"
        raise ConfigError([Problem(message, str(path), hint="choose another with -o")]) from error


def camera_file_text(model: CameraModel) -> str:
    """Return a camera file that `load_camera_model` reads as the same model."""
    provenance = model.provenance
    notes = "".join(f"    {as_toml(note)},\n" for note in provenance.notes)
    return f"""\
# A camera for stadimeter. Made by: {_one_line(provenance.method) or "hand"}.

# The pictures that it is for; for others of the same aspect it is scaled.
width_px = {model.width_px}
height_px = {model.height_px}

# Focal length, and where the optical axis meets the picture, from the centre of its top left pixel.
fx_px = {model.fx_px!r}
fy_px = {model.fy_px!r}
cx_px = {model.cx_px!r}
cy_px = {model.cy_px!r}

# How the lens bends lines: k1, k2, p1, p2 and perhaps k3 as OpenCV has them; empty for not at all.
distortion = {list(model.distortion)!r}

# How code values follow from light: "srgb" for nearly every camera, "linear" for raw pictures.
tone_curve = {as_toml(model.tone_curve)}

# How coarsely the camera stores colour: "4:4:4", "4:2:2" or "4:2:0"; left to the driver where it is not written.
{_subsampling(model)}

# How far outwards each edge of a bright target is measured, in pixels.
edge_bias_px = {model.edge_bias_px!r}

# Its standard deviation: about 0.1 for a camera of whose tone curve and sharpening nothing is known.
edge_bias_sigma_px = {model.edge_bias_sigma_px!r}

# Standard deviation of the focal length as a share of it: {100 * model.focal_relative_sigma:.2g} %.
focal_relative_sigma = {model.focal_relative_sigma!r}
{_uncertainty(model.uncertainty)}
method = {as_toml(provenance.method)}
date = {as_toml(provenance.date)}
{_taken_with(provenance)}
# The figures that it came from; F is the focal length that one picture by itself gives.
notes = [
{notes}]
{_optics(model.optics)}"""


def _taken_with(provenance: Provenance) -> str:
    if not provenance.taken_with:
        return ""
    return f"""
# How the lens was set, as the pictures' EXIF data state it.
taken_with = {as_toml(dict(provenance.taken_with))}
"""


def _optics(optics: Optics | None) -> str:
    if optics is None:
        return ""
    lens = "" if optics.lens_position_dpt is None else f"lens_position_dpt = {optics.lens_position_dpt!r}\n"
    return f"""
# How the camera was set, as far as that changes the focal length in pixels; compared at the start of a run.
[optics]
sensor = {as_toml(optics.sensor)}
sensor_size_px = {list(optics.sensor_size_px)!r}
crop_px = {list(optics.crop_px)!r}
{lens}upside_down = {str(optics.upside_down).lower()}
"""


def _uncertainty(uncertainty: LensUncertainty | None) -> str:
    if uncertainty is None:
        return ""
    return f"""
# Standard deviations of {", ".join(PARAMETERS)}, and their correlations, row by row above the
# diagonal: from them follows how sure a distance is at each place in the picture.
lens_sigmas = {list(uncertainty.sigmas)!r}
lens_correlations = [
{_rows(uncertainty.correlations, len(PARAMETERS))}]
"""


def _rows(correlations: Sequence[float], count: int) -> str:
    """Return the part of a matrix above its diagonal, row by row."""
    left = iter(correlations)
    rows = (", ".join(repr(each) for each in islice(left, length)) for length in range(count - 1, 0, -1))
    return "".join(f"    {row},\n" for row in rows)


def _subsampling(model: CameraModel) -> str:
    return f"subsampling = {as_toml(model.subsampling)}" if model.subsampling else '# subsampling = "4:2:0"'


def _one_line(text: str) -> str:
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())


def _model(table: Mapping[str, Any], file: str, spans: Mapping[KeyPath, SourceSpan]) -> CameraModel:
    with _located(CameraModelTable, table, file, spans):
        return CameraModelTable.model_validate(dict(table)).to_model()


@contextmanager
def _located(
    model: type[BaseModel], table: Mapping[str, Any], file: str, spans: Mapping[KeyPath, SourceSpan]
) -> Iterator[None]:
    """Give what is wrong with a table its line."""
    try:
        yield
    except ValidationError as error:
        raise ConfigError(problems(findings_of(error, model, table, ()), file, spans)) from error
    except CalibrationError as error:
        raise ConfigError(problems([Finding((error.key,), str(error), code="bad-value")], file, spans)) from error


def with_optics(data: bytes, optics: Optics | None) -> bytes:
    """Return a picture file with the settings of its camera: a PNG as a chunk of text, any other kind unchanged.

    A chunk is its length, its kind, its data and a CRC of both (ISO/IEC 15948, 5.3); the first one is the header.
    """
    if optics is None or not data.startswith(_PNG_START):
        return data
    body = b"tEXt" + _OPTICS + json.dumps(to_builtins(optics)).encode("ascii")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return data[:_PNG_HEADER_BYTES] + chunk + data[_PNG_HEADER_BYTES:]


def optics_in(data: bytes) -> Optics | None:
    """Return the settings of the camera that took a picture, if its file says them behind its header."""
    found = _OPTICS_CHUNK.match(data, _PNG_HEADER_BYTES) if data.startswith(_PNG_START) else None
    try:
        return OpticsTable.model_validate_json(found[2]).to_optics() if found else None
    except ValidationError:
        return None


# The stereo file: two cameras, where the right one is, and how well that is known, as a TOML text ---------------------

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
    with _located(StereoFileTable, source.table, str(path), source.spans):
        return StereoFileTable.model_validate(dict(source.table)).to_rig()


def save_stereo_rig(path: Path, rig: StereoRig) -> None:
    """Write or replace a stereo file, or leave what was there as it was; see `save_as`."""
    save_as(path, stereo_file_text(rig), "stereo file")


def stereo_file_text(rig: StereoRig) -> str:
    """Return a stereo file that `load_stereo_rig` reads as the same cameras."""
    sigmas, correlations = split_covariance(rig.covariance)
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
{_rows([float(f"{each:.10g}") for each in correlations], UNKNOWNS)}]

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
