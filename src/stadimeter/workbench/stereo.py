"""Two cameras at the desk: pictures that belong together, boards in both of them, and targets measured in both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct
from msgspec.structs import asdict, replace

from stadimeter.app.detectors import build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.core.words import metres
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.ranging.stereo import StereoFigures, measure_pair
from stadimeter.ranging.stereo_calibration import PairView, StereoCalibration, calibrate_stereo, check_pair_count
from stadimeter.workbench.calibration.board_session import Board, BoardViews, find_boards, today
from stadimeter.workbench.measuring import Measuring, PictureResult, TargetResult, failed_results, open_picture

PicturePair = tuple[Path, Path]


def pair_pictures(paths: Sequence[Path]) -> list[PicturePair]:
    """Return pairs of pictures from those of the left camera, in order, followed by those of the right camera.

    Raises:
        ConfigError: Their number is odd, or a picture is given twice.
    """
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise ConfigError(f"{path} is given twice; both cameras take a picture of their own")
    half = len(paths) // 2
    if 2 * half != len(paths) or not half:
        raise ConfigError(
            f"there are {len(paths)} pictures; give as many of both cameras, first those of the left camera, in the "
            "same order"
        )
    return list(zip(paths[:half], paths[half:], strict=True))


class BoardPairs(Struct, frozen=True, kw_only=True):
    """The sightings of a board by two cameras.

    Attributes:
        pairs: The pairs of pictures in which it was in both.
        missed: Both pictures and the reason, for each other pair.
        sides: What was found in the pictures of the left and of the right camera.
    """

    pairs: tuple[PairView, ...]
    missed: tuple[tuple[str, str, str], ...]
    sides: tuple[BoardViews, BoardViews]

    def calibrate(self, square_share: float) -> StereoCalibration:
        """Calibrate both cameras, each by itself and then together; see `calibrate_stereo`."""
        check_pair_count(len(self.pairs), "show the board in both pictures")
        left, right = self.sides
        alone = left.calibrate([each.left for each in self.pairs]), right.calibrate([each.right for each in self.pairs])
        return calibrate_stereo(self.pairs, alone, date=today(), square_share=square_share)


def find_board_pairs(
    pairs: Sequence[PicturePair], board: Board, watched: Callable[[Sequence[Path]], Iterable[Path]] = iter
) -> BoardPairs:
    """Look for a board in pairs of pictures.

    Args:
        watched: Goes through the pictures, such as to show how many are done.

    Raises:
        PictureError: A picture cannot be read.
        CalibrationError: The pictures of one camera differ in resolution, or in how it was set.
    """
    left, right = (find_boards(paths, board, watched) for paths in zip(*pairs, strict=True))
    seen = {view.picture: view for view in (*left.views, *right.views)}
    reasons = dict((*left.missed, *right.missed))
    views, missed = [], []
    for one, two in ((str(one), str(two)) for one, two in pairs):
        if one in seen and two in seen:
            views.append(PairView(left=seen[one], right=seen[two]))
        else:
            missed.append((one, two, "; ".join(f"{each}: {reasons[each]}" for each in (one, two) if each in reasons)))
    return BoardPairs(pairs=tuple(views), missed=tuple(missed), sides=(left, right))


class PairResult(TargetResult, frozen=True, kw_only=True, eq=False):
    """Result for one target in a pair of pictures; where the target is in the picture is said for the left one.

    Attributes:
        right_file: The picture of the right camera.
        alone: What each camera measured by itself, the left one first; empty if the target is not in both.
        figures: What both say of it together; None if the target is not in both, or not the same one.
    """

    right_file: str = ""
    alone: tuple[Measurement, ...] = ()
    figures: StereoFigures | None = None

    @property
    def note(self) -> str:
        """Disagreement of both cameras together with the target's size, if any."""
        return self.figures.disagreement if self.figures else ""

    def more(self) -> Iterator[tuple[str, str]]:
        """Yield what both cameras say together, and what each says by the target's size."""
        if self.figures is None:
            return
        both = self.figures
        missed = f"the lines of sight miss each other by {abs(both.miss_px):.2f} px ± {both.miss_sigma_px:.2f}"
        yield "together", f"{metres(both.distance_m, both.sigma_m)} without its size; {missed}"
        if both.size_m is not None and both.size_sigma_m is not None:
            left, right = (metres(each.distance_m or 0.0, each.sigma_m or 0.0) for each in self.alone)
            by_size = metres(both.size_m, both.size_sigma_m)
            yield "by size", f"{by_size}; the left camera alone {left}, the right one {right}"

    def record(self) -> dict[str, object]:
        """Return the result as the object that ``--json`` prints."""
        names = ("distance_m", "sigma_m", "size_m", "size_sigma_m", "miss_px", "miss_sigma_px", "disagreement")
        keys = ("triangulated_m", "triangulated_sigma_m", "by_size_m", "by_size_sigma_m", *names[4:])
        figures = {} if self.figures is None else asdict(self.figures)
        own = {key: figures.get(name) for key, name in zip(keys, names, strict=True)}
        return super().record() | {"right_file": self.right_file} | own


class PairMeasuring:
    """Measures targets in one pair of pictures after the other."""

    def __init__(self, choices: Sequence[DriverChoice], rig: StereoRig) -> None:
        self._rig = rig
        self._targets = build_detectors(choices, rig.left)
        self._left = Measuring(self._targets, rig.left)
        self._right = Measuring(build_detectors(choices, rig.right), rig.right)

    def measure(self, left: Path, right: Path) -> PictureResult:
        """Return a result for each target; of tags without a number, one for each that is seen in either picture.

        Where a picture cannot be read, or has another aspect than its camera, the status is ``error`` and the reason
        says why.
        """
        frame = None
        try:
            frame, other = open_picture(left), open_picture(right)
            rig = self._rig.for_frames(frame, other)
            both = self._left.measure(frame, str(left)).targets, self._right.measure(other, str(right)).targets
            targets = [_measure_both(*each, (str(left), str(right)), rig) for each in _match(*both)]
            return PictureResult(file=str(left), frame=frame, targets=tuple(targets))
        except StadimeterError as error:
            return PictureResult(file=str(left), frame=frame, targets=failed_results(str(left), self._targets, error))


def _match(
    left: Sequence[TargetResult], right: Sequence[TargetResult]
) -> Iterator[tuple[TargetResult | None, TargetResult | None]]:
    """Yield the results of one target in both pictures; None where a tag that was found in one is not in the other."""
    numbered = {each.measurement.target for each in (*left, *right) if _has_number(each)}
    # Where no tag was seen at all the answer has no number; if the other picture has one, it says nothing.
    first, second = (
        {each.label: each for each in results if _has_number(each) or each.measurement.target not in numbered}
        for results in (left, right)
    )
    for label in dict.fromkeys((*first, *second)):
        yield first.get(label), second.get(label)


def _has_number(result: TargetResult) -> bool:
    return result.detection is not None and result.detection.number is not None


def _measure_both(
    left: TargetResult | None, right: TargetResult | None, files: tuple[str, str], rig: StereoRig
) -> PairResult:
    either = left or right
    if either is None:
        raise ValueError("a target is in one of two pictures at least")
    made = PairResult(**asdict(either) | {"file": files[0], "right_file": files[1], "parts": None})
    if left is None or right is None or not (_is_located(left) and _is_located(right)):
        return replace(made, measurement=_in_one(left, right, files), direction_sigmas_rad=None)
    if left.seen is None or right.seen is None:
        return made
    measurement, figures = measure_pair(left.seen, right.seen, rig)
    sigmas_rad = None if figures is None else made.direction_sigmas_rad
    alone = left.measurement, right.measurement
    return replace(made, measurement=measurement, figures=figures, alone=alone, direction_sigmas_rad=sigmas_rad)


def _is_located(result: TargetResult) -> bool:
    return result.seen is not None and result.seen.measurement.distance_m is not None


def _in_one(left: TargetResult | None, right: TargetResult | None, files: tuple[str, str]) -> Measurement:
    """Return why there is no distance for a target that is not whole in both pictures."""
    reasons, alone, missing = [], "", []
    for side, result, file in (("left", left, files[0]), ("right", right, files[1])):
        measured = result and result.measurement
        if measured and measured.distance_m is not None:
            away = metres(measured.distance_m, measured.sigma_m or 0.0)
            alone = f"; the {side} camera alone has it at {away}"
        else:
            reasons.append(f"{file}: {measured.reason if measured else 'it is not there'}")
            missing.append(measured.status if measured else MeasurementStatus.NOT_FOUND)
    name = next(each.measurement.target for each in (left, right) if each)
    return Measurement(target=name, status=missing[0], captured_at_s=0.0, reason="; ".join(reasons) + alone)
