"""What to try where no pixel of a picture has a target's colour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stadimeter.config.plugins import DriverChoice
from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.protocol import ColourProposal, ColourSample
from stadimeter.workbench.measuring import PictureResult


def colour_notes(result: PictureResult, choices: Sequence[DriverChoice], told: set[str]) -> Iterator[str]:
    """Yield a sentence for each target of which a picture shows nothing at all, though a ball stands out in it.

    Args:
        choices: The targets' detectors.
        told: The targets that this was tried for in earlier pictures; once is enough, since it takes seconds.
    """
    proposers = {choice.name: choice.plugin.propose_colour for choice in choices if choice.name not in told}
    for each in result.targets:
        propose, seen = proposers.get(each.measurement.target), each.detection
        if propose is None or result.frame is None or seen is None:
            continue
        if seen.status is not DetectionStatus.NOT_FOUND or seen.rejected:
            continue
        told.add(each.measurement.target)
        proposal: ColourProposal | None = propose([ColourSample(result.frame)])
        found = proposal and proposal.views[0].detection
        if proposal and found and found.status is DetectionStatus.FOUND:
            (x_px, y_px), size_px = found.centre_px, found.width_px
            yield (
                f"{result.file}: something round, {size_px:.0f} px across at {x_px:.0f},{y_px:.0f}, has other colours; "
                f'if it is the target, its range is hsv = "{proposal.colour}"'
            )
