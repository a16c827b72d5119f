"""Remedies for a target that is refused: options that its detector proposes, each tried on the picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import KnowsRemedies, Remedy
from stadimeter.workbench.measuring import PictureResult

# Looks for a target with other options; returns None where it cannot be used.
Look = Callable[[DriverChoice], Detection | None]


def remedies_for(
    choice: DriverChoice, refused: Detection, frame: Frame, lens: CameraModel | None, look: Look | None = None
) -> list[Remedy]:
    """Return the changes with which something that was refused in a picture is accepted: one of each option at most.

    Args:
        lens: The lens at the picture's resolution, with which it was refused; None where it is not known.
        look: How to try a change; it is looked for in the picture if this is None.
    """
    (named,) = build_detectors([choice], lens)
    detector = named.detector
    if refused.status is not DetectionStatus.NOT_FOUND or not isinstance(detector, KnowsRemedies):
        return []
    helpful: dict[str, Remedy] = {}
    for remedy in detector.remedies() if refused.rejected else ():
        if remedy.key in helpful:
            continue
        changed = replace(choice, options=remedy.options)
        found = look(changed) if look else build_detectors([changed], lens)[0].detector.detect(frame, lens=lens)
        if found is not None and found.status is DetectionStatus.FOUND and _was_refused(found, refused):
            helpful[remedy.key] = remedy
    return [*helpful.values()]


def remedy_notes(
    result: PictureResult, choices: Sequence[DriverChoice], camera_model: CameraModel, noted: set[str]
) -> Iterator[str]:
    """Yield a sentence for each target that would be found in a picture with other options.

    Args:
        noted: The targets with a note in an earlier picture; each gets one note.
    """
    refused = {each.measurement.target: each.detection for each in result.targets}
    for choice in choices:
        detection = refused.get(choice.name)
        if choice.name in noted or detection is None or result.frame is None:
            continue
        lens = camera_model.for_frame(result.frame)
        remedies = remedies_for(choice, detection, result.frame, lens)
        if remedies:
            noted.add(choice.name)
            yield f"{result.file}: {choice.name} is found with {' or '.join(map(str, remedies))}"


def _was_refused(found: Detection, refused: Detection) -> bool:
    return any(math.dist(found.centre_px, each.centre_px) < each.size_px / 2 for each in refused.rejected)
