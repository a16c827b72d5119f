"""What the setup knows so far: the answers, and what was seen with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stadimeter.config.driver_tables import DriverKind, read_driver_table
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import validation_context
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, Problem, reason_of
from stadimeter.workbench.frame_source import Opening, opened

CONFIGURATION = "stadimeter.toml"
CAMERA_FILE = "camera.toml"
PICTURES = "init"
"""The folder for the pictures that show what was found."""
BOARD_FILE = f"{PICTURES}/board.toml"
"""The camera file of views of a board, which is no answer yet; saving makes it the one of the configuration."""


@dataclass(slots=True, kw_only=True)
class Known:
    """What is known so far.

    Attributes:
        folder: Where the files will be; relative paths in answers are relative to it.
        answers: The answers by key, in the order in which they were given.
        camera: The camera that was chosen.
        is_live: Whether it shows what is before it now, rather than a recording.
        frames: Pictures of it: one of a live camera, a few from all over a recording. The first is shown to people.
        camera_model: The lens; None before the calibration.
        model_file: The camera file that was there already; empty where one has to be written.
        opening: Opens the camera for a look through it.
        looks_ahead: Whether a question finds out by itself what takes seconds to find: what each camera sees, and what
            stands out in the picture. A face with pictures asks for that when it is wanted.
    """

    folder: Path
    answers: dict[str, str] = field(default_factory=dict)
    camera: DriverChoice | None = None
    is_live: bool = False
    frames: tuple[Frame, ...] = ()
    camera_model: CameraModel | None = None
    model_file: str = ""
    opening: Opening = opened
    looks_ahead: bool = True

    @property
    def frame(self) -> Frame:
        """The picture that is shown to people."""
        return self.frames[0]

    def shown_in(self, name: str) -> str:
        """Return the sentence that names a picture of what was found; empty for a face that shows it anyway."""
        return f" {name} shows it." if self.looks_ahead else ""

    @property
    def file(self) -> Path:
        """The configuration that will be written."""
        return self.folder / CONFIGURATION

    def path(self, name: str) -> Path:
        """Return the path of a file that an answer names."""
        return self.folder / Path(name).expanduser()

    def make_folder(self) -> None:
        """Make the folder, and the one for pictures in it; a `ConfigError` says why that cannot be."""
        try:
            (self.folder / PICTURES).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                [Problem(f"the folder cannot be made: {reason_of(error)}", str(self.folder / PICTURES))]
            ) from error

    def chosen(self, kind: DriverKind[Any], at: tuple[str, ...], table: dict[str, Any]) -> DriverChoice:
        """Return the driver of a table as the configuration will hold it.

        Raises:
            ConfigError: It says everything that is wrong; where it stands is nothing that a person has written.
        """
        read = read_driver_table(kind, at, table, validation_context(self.file))
        if read.choice is None or read.findings:
            raise ConfigError(Problem(each.message, hint=each.hint) for each in read.findings)
        return read.choice
