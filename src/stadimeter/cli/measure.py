"""The command ``measure``: how far away a target is in pictures, in videos, or before a camera."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.exits import DONE, NOT_FOUND, WRONG, configuration_path, make_folder, plain_errors, say_note
from stadimeter.cli.formatting import (
    METRE,
    LengthUnit,
    format_bearing,
    format_distance,
    format_place,
    format_position,
    format_tilt,
)
from stadimeter.cli.target_options import (
    GivenTarget,
    LiveOption,
    Option,
    WantedTargets,
    camera_choice,
    check_one_source,
    takes_options,
    targets_from_options,
)
from stadimeter.config.addresses import words_for_people
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.plugins import CAMERAS, DriverChoice, load_driver
from stadimeter.config.units import parse_known, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import ConfigError, PictureError, Problem, StadimeterError
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA
from stadimeter.ranging.measure import DrawnBox, Separation, SigmaParts, SizeAt, box_size_at, size_at
from stadimeter.workbench import measuring
from stadimeter.workbench.annotation import Mark, annotate, write_picture
from stadimeter.workbench.colour_aids import colour_notes
from stadimeter.workbench.measuring import Measuring, PictureResult, TargetResult, is_video_file, open_picture
from stadimeter.workbench.picture_metadata import other_lens_notes, profile_notes

if TYPE_CHECKING:
    from stadimeter.core.stereo_rig import StereoRig


# ``measure --stereo``: the stereo file of two cameras, and what does not go with it -----------------------------------


def load_rig(file: Path, images: Sequence[Path], others: Mapping[str, object]) -> StereoRig:
    """Read a stereo file; `ConfigError` for what does not go with it, too: other options, and videos."""
    from stadimeter.config.camera_file import load_stereo_rig  # noqa: PLC0415 - one camera needs none

    if given := [option for option, value in others.items() if value is not None]:
        raise ConfigError(f"--stereo measures pairs of pictures with the lenses of its file; leave out {given[0]}")
    if videos := [each for each in images if is_video_file(each)]:
        raise ConfigError(
            f"--stereo measures pairs of pictures, and {videos[0]} is a video; take its frames as pictures"
        )
    return load_stereo_rig(file)


# ``measure --at``: how large what is seen is, if its distance is known; of a target, or of a box that is given --------


def parse_at(text: str) -> tuple[float, float]:
    """Read ``--at``; return the distance and its standard deviation in metres.

    Raises:
        ConfigError: It is no length above zero.
    """
    try:
        at = parse_known(text, parse_length, parse_length)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key="--at", hint="write it such as 2m or '2m ± 1cm'")]) from error
    return at.value, DISTANCE_RELATIVE_SIGMA * at.value if at.sigma is None else at.sigma


def parse_box(text: str) -> DrawnBox:
    """Read ``--box``; `ConfigError` if it is no box."""
    hint = "write it such as 120,80,200,150: left top corner, width and height"
    try:
        x_px, y_px, width_px, height_px = map(float, text.split(","))
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is not four numbers", key="--box", hint=hint)]) from error
    if not (0 <= x_px < 1e6 and 0 <= y_px < 1e6 and 0 < width_px < 1e6 and 0 < height_px < 1e6):
        raise ConfigError([Problem(f"{text!r} is no box with a width and a height", key="--box", hint=hint)])
    return DrawnBox(x_px, y_px, width_px, height_px)


def check_alone(option: str, given: GivenTarget, others: Mapping[str, object]) -> None:
    """Raise a `ConfigError` where there is a target beside an option that needs none, or another option."""
    found = [flag for flag, value in {**given, **others}.items() if value not in (None, [])]
    if found:
        raise ConfigError(f"{option} measures no target; leave out {found[0]}")


def measure_boxes(
    images: Sequence[Path], camera_file: Path | None, text: str, at: tuple[float, float] | None, *, as_json: bool
) -> int:
    """Print how large what fills a box is in each picture; return the exit code.

    Raises:
        ConfigError: Something that it needs is missing or wrong, or the box reaches out of a picture.
        PictureError: A picture cannot be read.
    """
    if at is None:
        raise ConfigError("--box has a size only at a known distance; add such as --at 2m")
    if not images or camera_file is None:
        raise ConfigError("--box needs pictures, and the camera file with --camera")
    box, camera = parse_box(text), load_camera_model(camera_file)
    for image in images:
        frame = open_picture(image)
        if box.x_px + box.width_px > frame.width_px or box.y_px + box.height_px > frame.height_px:
            hint = f"the picture {image} has {frame.width_px}x{frame.height_px} px"
            raise ConfigError([Problem("the box reaches out of the picture", key="--box", hint=hint)])
        print_size(str(image), "box", box_size_at(box, camera.for_frame(frame), at), at[0], METRE, as_json=as_json)
    return DONE


def target_size(result: TargetResult, at: tuple[float, float]) -> SizeAt | None:
    """Return the size of a target that was measured by its size; None for one that was not."""
    seen, found = result.seen, result.detection
    if seen is None or found is None or result.parts is None:
        return None
    measured = seen.measurement if result.floor is None else result.floor.by_size
    return size_at(measured, result.parts, seen.shape, found.height_px > found.width_px, at)


def print_size(file: str, name: str, size: SizeAt | None, at_m: float, unit: LengthUnit, *, as_json: bool) -> None:
    """Print width and height, as a line or as an object."""
    if as_json:
        figures = {each: getattr(size, each, None) for each in SizeAt.__struct_fields__}
        typer.echo(json.dumps({"file": file, "target": name, "at_m": at_m, **figures}))
    elif size is None:
        typer.echo(f"{file}  {name}  size at {format_distance(at_m, None, unit)}: unknown, it is not measured")
    else:
        width = format_distance(size.width_m, size.width_sigma_m, unit)
        height = format_distance(size.height_m, size.height_sigma_m, unit)
        typer.echo(f"{file}  {name}  at {format_distance(at_m, None, unit)}: {width} wide, {height} high")


# ``measure --where``: where the camera was, by tags of known places ---------------------------------------------------


def print_places(images: Sequence[Path], config: Path | None, *, as_json: bool) -> int:
    """Print where the camera was in each picture, and return the worst of their exit codes.

    Raises:
        ConfigError: There is no picture, or the configuration knows no places, or has no lens.
    """
    from stadimeter.app.bootstrap import locator_of  # noqa: PLC0415 - loads the rules; targets need none
    from stadimeter.app.messages import pose_figures  # noqa: PLC0415
    from stadimeter.config.loader import load_configuration  # noqa: PLC0415

    if not images:
        raise ConfigError("--where needs pictures")
    configuration = load_configuration(configuration_path(config), with_tests=False)
    locator, lens = locator_of(configuration), configuration.camera_model
    if locator is None or lens is None:
        hint = "say in [landmarks] where tags are, and in [camera] model = which lens it has; see docs/places.md"
        missing = "no section [landmarks]" if locator is None else "no camera file"
        raise ConfigError([Problem(f"there is {missing}", file=str(configuration.path), hint=hint)])
    code = DONE
    for image in images:
        try:
            frame = open_picture(image)
            pose = locator.locate(frame, lens.for_frame(frame))
        except StadimeterError as error:
            typer.echo(f"error: {error}", err=True)
            code = WRONG
            continue
        figures = {"file": str(image), **pose_figures(pose)}
        typer.echo(json.dumps(figures, ensure_ascii=False) if as_json else f"{image}: {pose.in_words()}")
        code = max(code, DONE if pose.position_m is not None else NOT_FOUND)
    return code


# All else is not found, "perhaps" too: a script that goes by the exit code acts on nothing that is in doubt.
EXIT_CODES = {MeasurementStatus.MEASURED: DONE, MeasurementStatus.ERROR: WRONG}


@takes_options(
    config=Option("FILE", "Look for the targets of this configuration, through its camera."),
    copies=Option("DIR", "Write a copy of each picture there, with what was measured.", flags="--annotate"),
    between=Option(
        "A,B", "Print how far apart two targets are as well: tags by their numbers, or targets of --config by name."
    ),
    stereo=Option("FILE", "Measure with two cameras: their stereo file, made by `stadimeter calibrate stereo`."),
    at=Option(
        "DISTANCE",
        "Print how large the target is if it is that far away, such as 2m or '2m ± 1cm'; 1 % of it without ±.",
    ),
    box=Option(
        "X,Y,W,H",
        "With --at: how large what fills this box is, in pixels, left top corner first. In place of a target.",
    ),
    where=Option("", "Print where the camera was, by the tags of [landmarks] of --config, and measure no target."),
    explain=Option("", "Say how each result came about, and what was rejected and why."),
)
def measure(
    *,
    target: GivenTarget,
    images: Annotated[
        list[Path] | None, typer.Argument(metavar="IMAGE|VIDEO", help="Picture files, and video files.")
    ] = None,
    camera: Path | None = None,
    config: Path | None = None,
    as_json: bool = False,
    copies: Path | None = None,
    live: LiveOption = None,
    between: str | None = None,
    stereo: Path | None = None,
    at: str | None = None,
    box: str | None = None,
    where: bool = False,
    explain: bool = False,
) -> None:
    """Measure how far away a target is: in pictures, or before a camera.

    Needs the target's size, and a camera file from `stadimeter calibrate distance` for the camera that took the
    pictures. A camera file fits every resolution of the same aspect.

    Prints one line for each picture: the distance, which is the length of the straight line from the camera to the
    target's centre, with its standard deviation; the depth, which is the part of it along the optical axis; and the
    position in the camera's frame: x to the right, y down, z forward. Of a tag it says which one it is. A target that
    is cut off by the border of the picture has no size, so it has no distance. What is the best explanation of the
    picture but may be another thing has one, with "perhaps" before it and the doubt behind it.

    With --json, each line is an object with file, target, status (measured, not_found, truncated or error), perhaps,
    distance_m, depth_m, sigma_m, bearing_rad (positive to the right), elevation_rad (positive upwards), tilt_rad (of
    something flat, 0 for face on), ambiguity (0 if the tilt is certain, 1 if it may as well be the other way), reason,
    x_m, y_m, z_m, bearing_sigma_rad, elevation_sigma_rad, outline_px (corners, or points on the rim), id (of a tag),
    frame and time_s (of a video or a camera); with a configuration whose camera has a mount, robot_x_m (ahead),
    robot_y_m (to the left) and robot_z_m (up).

    A video, or a camera with --live, gives one line for each frame, with its number and its time in seconds from the
    first one on. A camera goes on until Ctrl-C.

    With --between, a further line for each picture says how far apart the centres of two targets are that it shows: two
    tags by their numbers, or two targets of a configuration; so it does with --target given twice.
    With --json, an object with file, between, distance_m, sigma_m, frame and time_s.

    With --at, a further line says how wide and high the target is if it is that far away, whatever size it was given.
    With --box, no target is looked for: what fills the box is measured as if it faced the camera, its edges drawn to
    within a pixel. With --json, an object with file, target, at_m, width_m, height_m, width_sigma_m, height_sigma_m.

    With --where, a line for each picture says where the camera was: x, y and z in the room (z up), yaw (where the
    camera looks, counter-clockwise from the x axis), tilt (up from level) and roll (its right side down), each with its
    standard deviation, and the tags that tell; or why it is not known. A tag that is not where the configuration says
    is named. With --json, an object with file, x_m, y_m, z_m, yaw_rad, tilt_rad, roll_rad, orientation (a quaternion
    x, y, z, w of the body with x forward, y left and z up), covariance (36 numbers as in ROS's PoseWithCovariance),
    tags, moved and reason.

    With --explain, each line is followed by what was seen and how sharply, what the standard deviation is made up of,
    and what was looked at but rejected: where it is, how large, and the test that it failed. With --json as further
    fields, among them rejected, a list of objects; with --annotate drawn into the copies under the same numbers,
    beside yellow dots where edges of the target were seen.

    With --stereo, pictures are pairs that two cameras took at the same time: first those of the left camera, then as
    many of the right one. The target is looked for in both, and its distance from the left camera is triangulated,
    which does not need its size, and joined with the distances by its size. If these disagree, that is said.

    **Examples**

    - `stadimeter measure 3ft.png 4ft.png --camera camera.toml --sheet 11in,8.5in`

    - `stadimeter measure shots/*.jpg --camera camera.toml --ball 6.4cm --hsv "29,86,6:64,255,255" --json`

    - `stadimeter measure shots/*.jpg --config config/follow-ball.toml --annotate annotated`

    - `stadimeter measure dark.jpg --camera camera.toml --tag 8cm --family 36h11 --explain`

    - `stadimeter measure drive.mp4 --camera camera.toml --tag 8cm --family 36h11 --between 3,7 --json`

    - `stadimeter measure door.jpg --camera camera.toml --at 2m --box 120,80,200,150`

    - `stadimeter measure --live opencv,device=0 --camera camera.toml --tag 8cm --family 36h11`

    - `stadimeter measure lawn.jpg --where --config mower.toml`

    - `stadimeter measure --stereo stereo.toml left.jpg right.jpg --ball 6.4cm`

    **Exit code**: 0 everything was measured, in a video or by a camera in one frame at least; 1 a target was not
    found, only perhaps, or cut off; 2 an option, a file or a picture is wrong. A bad picture does not stop the others.
    """
    with plain_errors():
        known_at = None if at is None else parse_at(at)
        if box is not None:
            check_alone("--box", target, {"--config": config})
            raise typer.Exit(measure_boxes(images or [], camera, box, known_at, as_json=as_json))
        if where:
            check_alone("--where", target, {"--camera": camera, "--live": live, "--stereo": stereo, "--at": at})
            raise typer.Exit(print_places(images or [], config, as_json=as_json))
        others = {"--camera": camera, "--live": live, "--between": between}
        rig = None if stereo is None else load_rig(stereo, images or [], others)
        check_one_source(images, live, "pictures or videos")
        names = _pair_from_option(between, target)
        wanted = _targets_from_options(target, config, names)
        if names is None and config is None and len(wanted.choices) == 2:  # of two --target
            names = wanted.choices[0].name, wanted.choices[1].name
        camera_model = _lens(camera, wanted) if rig is None else rig.left
        # The configuration or the driver: its options would fill each line.
        name = words_for_people((live or "").partition(",")[0])
        work = _Work(
            measuring=Measuring(
                build_detectors(wanted.choices, camera_model, wanted.footings), camera_model, wanted.mount
            ),
            wanted=wanted,
            camera_model=camera_model,
            printer=Printer(
                as_json=as_json,
                explain=explain,
                unit=wanted.unit,
                file_width=max(map(len, [name, *map(str, images or ())])),
                target_width=max(len(name) for choice in wanted.choices for name in choice.members),
            ),
            between=names,
            at=known_at,
        )
        code = work.frames(camera_choice(live), name) if live else work.files(images or [], rig, copies)
    raise typer.Exit(code)


def _video(path: Path) -> DriverChoice:
    options = load_driver(CAMERAS, "video").model_validate({"path": str(path)})
    return DriverChoice(name="video", driver="video", options=options)


def _pair_from_option(between: str | None, given: GivenTarget) -> tuple[str, str] | None:
    if between is None:
        return None
    one, _, other = (each.strip() for each in between.partition(","))
    if not (one and other) or one == other:
        raise ConfigError(f"--between: {between!r} does not name two targets; write it such as 3,7")
    if given.get("--tag") is None:
        return one, other
    if given.get("--id") is not None:
        raise ConfigError("--between names two tags, --id one; give one of them")
    try:
        return f"tag {int(one)}", f"tag {int(other)}"
    except ValueError:
        raise ConfigError(f"--between: {between!r} are not the numbers of two tags; write it such as 3,7") from None


def _targets_from_options(given: GivenTarget, config: Path | None, names: tuple[str, str] | None) -> WantedTargets:
    """Return the targets; of two tags, one for each of them."""
    if names is None or given.get("--tag") is None:
        wanted = targets_from_options(given, config, several=True)
    else:
        both = [(name, targets_from_options({**given, "--id": int(name.split()[1])}, config)) for name in names]
        choices = tuple(replace(each.choices[0], name=name) for name, each in both)
        wanted = replace(both[0][1], choices=choices)
    known = [name for choice in wanted.choices for name in choice.members]
    missing = [name for name in names or () if name not in known]
    if missing:
        raise ConfigError(
            f"--between: there is no target {missing[0]!r}, only {', '.join(known)}; give two tags by their numbers "
            "with --tag, or two targets of --config by name"
        )
    return wanted


def _lens(file: Path | None, wanted: WantedTargets) -> CameraModel:
    """Return the lens of a camera file, or that of the configuration."""
    if file is not None:
        model = load_camera_model(file)
        if words := model.off_centre_words:
            say_note(words)
        return model
    if wanted.camera_model is not None:
        return wanted.camera_model
    hint = "make one with `stadimeter calibrate distance PICTURE@DISTANCE -o FILE`"
    raise ConfigError(
        [Problem("the camera file is missing; without it pixels say nothing about metres", key="--camera", hint=hint)]
    )


class _Work(Struct, frozen=True, kw_only=True):
    """Everything that `measure` needs for its inputs: what to look for, through which lens, and how to print it."""

    measuring: Measuring
    wanted: WantedTargets
    camera_model: CameraModel
    printer: Printer
    between: tuple[str, str] | None
    at: tuple[float, float] | None = None
    proposed: set[str] = field(default_factory=set)  # targets for which other options have been proposed

    def files(self, files: Sequence[Path], rig: StereoRig | None, copies: Path | None) -> int:
        """Measure pictures, pairs of them or videos one after the other, and return the worst of their exit codes."""
        for note in (*profile_notes(files), *other_lens_notes(self.camera_model, files)):
            say_note(note)
        taken: Sequence[tuple[Path, ...]] = [(each,) for each in files]
        measure: Callable[..., PictureResult] = self.measuring.measure_file
        if rig is not None:
            from stadimeter.workbench.stereo import PairMeasuring, pair_pictures  # noqa: PLC0415 - one needs none

            taken, measure = pair_pictures(files), PairMeasuring(self.wanted.choices, rig).measure
        paths = copy_paths([first for first, *_ in taken if not is_video_file(first)], copies)
        return max(
            self.frames(_video(each[0]), str(each[0]))
            if is_video_file(each[0])
            else self._report(measure(*each), paths.get(each[0]))
            for each in taken
        )

    def _report(self, result: PictureResult, copy: Path | None) -> int:
        """Print what was found, with what would help, and write the copy; return the exit code."""
        code = self._printed(result)
        for words in (
            *colour_notes(result, self.wanted.choices, self.proposed),
            *measuring.remedy_notes(result, self.wanted.choices, self.camera_model, self.proposed),
        ):
            say_note(words)
        if copy is not None and result.frame is not None:
            marks = marks_of(result, self.wanted.unit, explain=self.printer.explain)
            try:
                write_picture(copy, annotate(result.frame.image, marks))
            except PictureError as error:
                typer.echo(f"error: {error}", err=True)
                return WRONG
        return code

    def frames(self, choice: DriverChoice, name: str) -> int:
        """Measure the frames of a video or a camera until they end or Ctrl-C; 0 if any shows all targets."""
        from stadimeter.workbench.frame_source import open_source  # noqa: PLC0415 - loads the rules; pictures need none

        source = open_source(choice)
        seen, code = 0, NOT_FOUND
        try:
            source.capture.open()
            for remark in source.capture.remarks():
                say_note(remark)
            for result in self.measuring.measure_all(source, name, say_note):
                seen, code = seen + 1, min(code, self._printed(result))
        except KeyboardInterrupt:
            typer.echo(f"stopped after {seen} frames", err=True)
        except StadimeterError as error:
            for each in measuring.failed_results(name, self.measuring.targets, error):
                self.printer.result(each)
            return WRONG
        finally:
            source.capture.close()
        return code

    def _printed(self, result: PictureResult) -> int:
        for each in result.targets:
            self.printer.result(each)
            if self.at is not None:
                size, unit = target_size(each, self.at), self.wanted.unit
                print_size(each.file, each.label, size, self.at[0], unit, as_json=self.printer.as_json)
        if self.between is not None and result.frame is not None:
            self.printer.separation(result, self.between, self.measuring.between(result, self.between))
        return max(EXIT_CODES.get(each.measurement.status, NOT_FOUND) for each in result.targets)


# Output: lines or JSON objects for targets, ``--explain``, ``--between``, and annotated copies ------------------------


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

# Figures of what was seen that ``--json`` has under their own names, and the causes of the uncertainty.
SEEN_FIGURES = ("width_px", "height_px", "size_sigma_px", "quality")
CAUSES = ("edges_m", "focal_length_m", "size_m", "pose_m")

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


def _floor_lines(result: TargetResult) -> Iterator[tuple[str, str]]:
    """Say what the floor tells of a target that is on it, and what became of size and floor together."""
    floor = result.floor
    if floor is None or result.parts is None:
        return
    by_floor = "above the horizon" if floor.distance_m is None else format_distance(floor.distance_m, floor.sigma_m)
    both = format_distance(result.measurement.distance_m, result.measurement.sigma_m)
    size = format_distance(floor.by_size.distance_m, floor.by_size.sigma_m)
    yield "floor", f"{by_floor} by the floor, {size} by its size, {floor.apart_sigmas:.1f} σ apart; taken: {both}"
    if floor.measurement.reason:
        yield "remark", floor.measurement.reason


def explanation_record(result: TargetResult) -> dict[str, object]:
    """Return `explanation` as further fields of the object that ``--json`` prints, in metres and pixels."""
    found, parts = result.detection, result.parts
    seen = found if found is not None and found.status is not DetectionStatus.NOT_FOUND else None
    return {
        "remark": found.reason if found is not None and parts is not None else "",
        "centre_px": [_number(each) for each in seen.centre_px] if seen else None,
        **{key: _number(getattr(seen, key)) if seen else None for key in SEEN_FIGURES},
        **{f"sigma_{cause}": _number(getattr(parts, cause)) if parts else None for cause in CAUSES},
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


def _found_lines(found: Detection, measured: Measurement, parts: SigmaParts | None) -> Iterator[tuple[str, str]]:
    if found.width_px > 0:
        size = f"{found.width_px:.2f} x {found.height_px:.2f} px ± {found.size_sigma_px:.2f}"
        x, y = found.centre_px
        yield "seen", f"{size} at {x:.1f}, {y:.1f}, quality {found.quality:.2f}"
    if measured.tilt_rad is not None:
        yield "tilt", f"{format_tilt(measured.tilt_rad)}{_mirrored_words(measured)}"
    if parts is not None:
        yield "sigma", _sigma_in_words(measured, parts)
        if found.reason:
            yield "remark", found.reason


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
