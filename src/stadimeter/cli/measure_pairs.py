"""``measure --stereo``: the stereo file of two cameras, and what does not go with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stadimeter.errors import ConfigError
from stadimeter.workbench.measuring import is_video_file

if TYPE_CHECKING:
    from stadimeter.core.stereo_rig import StereoRig

StereoOption = Annotated[
    Path | None,
    typer.Option(
        "--stereo",
        metavar="FILE",
        help="Measure with two cameras: their stereo file, made by `stadimeter calibrate stereo`.",
    ),
]


def load_rig(file: Path, images: Sequence[Path], others: Mapping[str, object]) -> StereoRig:
    """Read a stereo file; `ConfigError` for what does not go with it, too: other options, and videos."""
    from stadimeter.config.stereo_file import load_stereo_rig  # noqa: PLC0415 - one camera needs none

    if given := [option for option, value in others.items() if value is not None]:
        raise ConfigError(f"--stereo measures pairs of pictures with the lenses of its file; leave out {given[0]}")
    if videos := [each for each in images if is_video_file(each)]:
        raise ConfigError(
            f"--stereo measures pairs of pictures, and {videos[0]} is a video; take its frames as pictures"
        )
    return load_stereo_rig(file)
