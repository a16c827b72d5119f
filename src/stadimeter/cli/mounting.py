"""The commands ``mounting …``: save the view of a fixed camera, and see whether the camera is still where it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from stadimeter.app.detectors import build_detectors
from stadimeter.app.mounting import (
    MOMENTS,
    PICTURES,
    judge_by,
    keep_apart,
    load_reference,
    make_reference,
    save_reference,
)
from stadimeter.cli.exits import DONE, NOT_FOUND, ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.operate import confirm
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError, EndOfFramesError, StateError
from stadimeter.perception.mounting import look_at
from stadimeter.perception.perceiver import Perceiver
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, source_beside_run

mounting = typer.Typer(no_args_is_help=True, rich_markup_mode="markdown")


@mounting.callback()
def _mounting() -> None:
    """Save the view of a fixed camera, and see whether the camera is still where it was.

    A run compares the view once a minute with the one that was saved; `docs/mounting.md` says what it finds.
    """


@mounting.command()
def save(config: ConfigArgument = None) -> None:
    """Save the view that the camera has now, as that of its mounting.

    Takes a dozen pictures, through the run if one has the camera, and keeps a few hundred features of what stands
    still: where each is and how it looks in 256 bits. No picture is kept. The file stands beside the configuration,
    with the ending `.mounting`, and a run watches from its next start on.

    **Example**

    - `stadimeter mounting save appliance.toml`

    **Exit code**: 0 saved; 2 the view has too little to go by, such as a white wall, or the camera gives no picture.
    """
    with plain_errors(), _pictures(config, PICTURES * MOMENTS) as (configuration, lens, frames):
        reference = make_reference(frames, lens, _targets(configuration, lens, frames[0]))
        path = save_reference(configuration.path, reference)
        typer.echo(f"{path}: {len(reference.views[0].features)} features that stand still")


@mounting.command()
def check(config: ConfigArgument = None) -> None:
    """Compare the view that the camera has now with the saved one, once.

    Prints the turn (pan to the right, tilt up, roll with the right side down), the zoom and the blur, each with its
    standard deviation. A run wants two such findings in a row before it says anything.

    **Example**

    - `stadimeter mounting check appliance.toml`

    **Exit code**: 0 as saved; 1 not so, or it cannot be judged; 2 no view was saved, or the camera gives no picture.
    """
    with plain_errors(), _pictures(config, PICTURES) as (configuration, lens, frames):
        reference = load_reference(configuration.path)
        if reference is None:
            raise StateError(f"{configuration.path}: no view of its camera was saved; `stadimeter mounting save` does")
        if why := reference.why_not_for(frames[0], lens):
            raise CalibrationError(why)
        view = look_at([each.image for each in frames], lens, _targets(configuration, lens, frames[0]))
        found = judge_by(reference, configuration, lens).judge(view)
        words = f"not as saved ({', '.join(found.found)})" if found.found else found.not_judged or "as saved"
        typer.echo(f"{words}: {found.best.in_words()}" if found.best is not None else words)
    raise typer.Exit(NOT_FOUND if found.found or found.not_judged else DONE)


mounting.command("confirm", help=confirm.__doc__)(confirm)


@contextmanager
def _pictures(config: Path | None, count: int) -> Iterator[tuple[Configuration, CameraModel, list[Frame]]]:
    configuration = load_configuration(configuration_path(config), with_tests=False)
    if configuration.camera_model is None:
        raise ConfigError("no camera file: say in [camera] model = which lens the camera has")
    source = source_beside_run(configuration.camera, configuration.path, None)
    try:
        source.settle()
        frames: list[Frame] = []
        while len(frames) < count:
            frames = keep_apart(frames, source.capture.latest(SETTLING_WAIT_S))
        yield configuration, configuration.camera_model.for_frame(frames[0]), frames
    except EndOfFramesError:
        raise CalibrationError(f"the recording ends before {count} pictures") from None
    finally:
        source.capture.close()


def _targets(configuration: Configuration, lens: CameraModel, frame: Frame) -> list[Points]:
    named = build_detectors(configuration.targets, configuration.camera_model, configuration.footings)
    detectors = {member: each.detector for each in named for member in each.members or (each.name,)}
    detections, _ = Perceiver(detectors, lens).look(frame)
    return [each.outline_px for each in detections if len(each.outline_px)]
