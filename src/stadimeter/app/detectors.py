"""The detectors of targets, each with its target's name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from stadimeter.detectors.protocol import Detector


class NamedDetector(Struct, frozen=True, kw_only=True):
    """A target that is looked for, or several of one kind.

    Attributes:
        members: The names of the targets: its own, or those of several.
        footing: What is known of it if it is on the floor.
    """

    name: str
    detector: Detector
    members: tuple[str, ...] = ()
    footing: Footing | None = None


def build_detectors(
    choices: Sequence[DriverChoice], camera_model: CameraModel | None, footings: Mapping[str, Footing] | None = None
) -> tuple[NamedDetector, ...]:
    """Build the detectors of targets, in the same order. Without a lens, only what needs none can be measured."""
    clock = SteppedClock()
    return tuple(
        NamedDetector(
            name=choice.name,
            members=choice.members,
            detector=choice.options.build(DriverContext(name=choice.name, clock=clock, camera_model=camera_model)),
            footing=(footings or {}).get(choice.name),
        )
        for choice in choices
    )
