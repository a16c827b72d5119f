"""The section ``[landmarks]``: tags whose places in the room are known. Loaded only where a configuration has one."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from stadimeter.config.driver_tables import TARGET, read_driver_table, validate
from stadimeter.config.findings import Finding
from stadimeter.config.models import Section
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import Angle, AngleOrZero, Coordinate, Length, LengthOrZero
from stadimeter.core.camera_pose import Landmarks, PlacedTag

_DEFAULTS = Landmarks(tags=())

SECTION = "landmarks"


class PlacedTagTable(Section):
    """A tag and its place. It hangs upright; lying on its back, its top points away from where it faces."""

    id: Annotated[int, Field(ge=0)]
    """Its number in the family."""
    at: Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
    """In metres; x, y and z of its centre: x and y on the floor, z up."""
    facing: Angle
    """In radians; which way it looks, counter-clockwise from the x axis as seen from above."""
    tilt: Angle = 0.0
    """In radians; how far it looks up from level: a quarter turn for a tag that lies on the floor."""
    roll: Angle = 0.0
    """In radians; how far it is turned in its own plane, clockwise as you look at it: half a turn if upside down."""
    size: Length | None = None
    """In metres; the side of its black square, if it is not `tag_size`."""


class LandmarksTable(Section):
    """Tags whose places are known, from which the camera's own place follows."""

    tag_size: Length
    """In metres; the side of their black squares, without the white around."""
    family: str = "apriltag-36h11"
    """Such as ``apriltag-36h11`` or ``aruco-4x4-50``."""
    tolerance: LengthOrZero = 0.0
    """In metres; one standard deviation of that side, the same for all: they come from one printer."""
    place_sigma: LengthOrZero = _DEFAULTS.place_sigma_m
    """In metres; one standard deviation of each coordinate of a tag's centre."""
    facing_sigma: AngleOrZero = _DEFAULTS.facing_sigma_rad
    """In radians; one standard deviation of how each tag is turned, about each axis."""
    tags: Annotated[list[PlacedTagTable], Field(min_length=1)]
    """Each tag with its place."""

    def to_plan(self) -> Landmarks:
        """Return the tags as the core sees them."""
        return Landmarks(
            tags=tuple(
                PlacedTag(
                    number=tag.id,
                    side_m=tag.size or self.tag_size,
                    position_m=(tag.at[0], tag.at[1], tag.at[2]),
                    facing_rad=tag.facing,
                    tilt_rad=tag.tilt,
                    roll_rad=tag.roll,
                )
                for tag in self.tags
            ),
            place_sigma_m=self.place_sigma,
            facing_sigma_rad=self.facing_sigma,
            size_relative_sigma=self.tolerance / self.tag_size,
        )


def read_landmarks(
    table: Mapping[str, Any], context: Mapping[str, Any], findings: list[Finding]
) -> tuple[Landmarks, DriverChoice] | None:
    """Read the section; return the tags and their detector, None if it cannot be used.

    Args:
        findings: What is wrong in the section is added here.
    """
    found = validate(LandmarksTable, table, (SECTION,), context, findings)
    if found is None:
        return None
    # The family, and which numbers it has, are for the detector to know.
    known = len(findings)
    driver = {TARGET.key: "tag", "side": table["tag_size"]} | {key: table[key] for key in ("family",) if key in table}
    choice, _ = read_driver_table(TARGET, (SECTION,), driver, context, findings)
    if choice is None or len(findings) > known:
        return None
    for place, tag in enumerate(found.tags):
        read_driver_table(TARGET, (SECTION, "tags", place), driver | {"id": tag.id}, context, findings)
    landmarks = found.to_plan()
    findings += _once_each(landmarks)
    return landmarks, choice


def _once_each(landmarks: Landmarks) -> Iterator[Finding]:
    numbers = [tag.number for tag in landmarks.tags]
    for place, number in enumerate(numbers):
        if number in numbers[:place]:
            message = f"tag {number} is listed twice; one tag is in one place"
            hint = "leave one of them out, or print a tag of another number"
            yield Finding((SECTION, "tags", place, "id"), message, hint, "used-twice")
