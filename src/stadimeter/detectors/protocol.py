"""The interface of detectors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from msgspec import Struct, field

from stadimeter.config.plugins import DriverOptions
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Plane, Points, Prediction, RejectedCandidate, TargetShape
from stadimeter.core.frame import Frame
from stadimeter.errors import PictureError

if TYPE_CHECKING:  # a run draws nothing
    from stadimeter.core.drawing import Drawing


# What people try in the table of a detector that finds one target, and what to write in its place.
ONE_OF_A_KIND = dict.fromkeys(("count", "ids"), "this detector finds one target; ball, tag and object find several")


class Detector(Protocol):
    """Finds one target in a frame. It keeps no state: the same frame, prediction and lens give the same answer."""

    @property
    def target_shape(self) -> TargetShape:
        """The known size and form of the target."""

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the target, without changing the image. A frame without it is an ordinary result, not an error.

        Args:
            prediction: Where the target is expected, for a detector that can look there first; None to search the whole
                frame. It may be wrong in any way, NaN included: a target that is not found there whole is looked for in
                the whole frame.
            lens: The camera model at the frame's resolution, which the answer will be measured with; None where it is
                not known yet, as while a camera is calibrated.

        Returns:
            Where the target is; or that it is cut off by the border; or that it is not there, with a reason that holds
                the figures: ``largest blob 6 px, limit 12 px``.

        Raises:
            PictureError: The image has not the form that a `Frame` promises, see `check_image`.
        """


@runtime_checkable
class FindsSeveral(Protocol):
    """A detector that can find several of its targets in one frame."""

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:
        """Look for all of its targets in the whole frame; see `Detector.detect`.

        Returns:
            Each that was found, with its `Detection.number` if it says which one it is; where there is none, what
                `Detector.detect` returns.
        """


@runtime_checkable
class TracksSeveral(Detector, FindsSeveral, Protocol):
    """A detector whose targets can be followed one by one; with `DriverOptions.members` its table stands for them."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """The `Detection.number` of each member, if these are fixed; empty if any may be any."""

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: CameraModel | None = None) -> Detection:
        """Look for one target where it is expected and nowhere else; see `Detector.detect`."""


@runtime_checkable
class ShowsEdges(Protocol):
    """A detector that can show where it sees the edges of a target that it has found."""

    def edge_points(self, frame: Frame, found: Detection, *, lens: CameraModel | None = None) -> Points:
        """Return the places where edges are seen, shape ``(n, 2)``, x and y in pixels; `found` is in the frame."""


class Remedy(Struct, frozen=True, kw_only=True):
    """Other options with which a target that was refused may be found.

    Attributes:
        key: The key of the target's table that differs.
        value: What it holds, as a person writes it.
        options: All the options.
    """

    key: str
    value: str
    options: DriverOptions

    def __str__(self) -> str:
        """Return it as a table has it."""
        return f'{self.key} = "{self.value}"'


@runtime_checkable
class KnowsRemedies(Protocol):
    """A detector that knows which of its options may be wrong where it refuses a target."""

    def remedies(self) -> Iterator[Remedy]:
        """Yield what to try; of several with one key, the first that helps is the best."""


class ColourSample(NamedTuple):
    """A picture of a target whose colour is wanted.

    Attributes:
        places_px: Where a person has pointed at the target, each x and y; empty if no one has.
    """

    frame: Frame
    places_px: tuple[tuple[float, float], ...] = ()


class ColourView(Struct, frozen=True, kw_only=True, eq=False):
    """The parts of a picture that a range of colours shows.

    Attributes:
        detection: The target, as it is found with the range.
        mask: Which pixels have the colour: 255 where one has, 0 elsewhere, shape ``(height, width)``.
        others: What else has the colour, the largest first.
    """

    detection: Detection
    mask: Plane
    others: tuple[RejectedCandidate, ...]


class ColourProposal(Struct, frozen=True, kw_only=True, eq=False):
    """A range of colours for a target.

    Attributes:
        colour: The range, as the configuration has it.
        views: What it shows in each picture.
        hue_margin: By how many hues, of 180, it can grow at both ends before it covers another thing; None for many.
    """

    colour: str
    views: tuple[ColourView, ...]
    hue_margin: int | None


@runtime_checkable
class ProposesColour(Protocol):
    """A detector that goes by colour; a part of its `DriverOptions`."""

    @staticmethod
    def propose_colour(samples: Sequence[ColourSample]) -> ColourProposal | None:
        """Return a range for all the pictures; None if nothing stands out there, or the background was pointed at."""

    @staticmethod
    def view_colour(frame: Frame, colour: str) -> ColourView:
        """Find what a range, as the configuration has it, shows in a frame; a ValueError says why it is none."""


class EngineTiming(Struct, frozen=True, kw_only=True):
    """The time an engine takes for a picture of 640x480 px; `trouble` says why it cannot run the network."""

    engine: str
    seconds: float | None = None
    trouble: str = ""


class NetworkReport(Struct, frozen=True, kw_only=True):
    """A description of a model file.

    Attributes:
        doubt: Why its family is not known; empty if it is.
        table: What a table of a configuration says of it, by key.
        timings: How fast each engine of this computer runs it.
    """

    producer: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    family: str = ""
    doubt: str = ""
    classes: tuple[str, ...] = ()
    table: Mapping[str, str] = field(default_factory=dict)
    timings: tuple[EngineTiming, ...] = ()


@runtime_checkable
class ExaminesNetwork(Protocol):
    """A detector that runs a network from a file; a part of its `DriverOptions`."""

    @staticmethod
    def examine_network(path: Path) -> NetworkReport:
        """Say what a model file is, and how fast it runs here; an UnreadableError or ValueError says why it is none."""


@runtime_checkable
class DrawsTarget(Protocol):
    """A detector whose target can be printed; a part of its `DriverOptions`."""

    def draw(self) -> Drawing:
        """Return the target at its true size, with the white rim that it needs."""


def check_image(frame: Frame) -> None:
    """Raise a `PictureError` unless an image has the shape ``(height, width, 3)``, 8 bits a channel and some pixels."""
    shape, dtype = frame.image.shape, frame.image.dtype
    if dtype != "uint8" or len(shape) != 3 or shape[2] != 3 or not frame.image.size:
        raise PictureError(
            f"a frame's image has the shape {shape} and the type {dtype}, not (height, width, 3) and uint8;"
            " the camera driver has to convert it"
        )
