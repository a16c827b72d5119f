"""What a device is sent and what it says of its configuration: the topics ``desired`` and ``configuration``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct, field

# The topics below the base topic of a device, both kept by the broker.
DESIRED, REPORT = "desired", "configuration"

Phase = Literal["try", "apply"]
Status = Literal["tried", "applying", "applied", "refused", "rolled-back"]
FAILED = frozenset[Status]({"refused", "rolled-back"})

_Name = Annotated[str, Meta(max_length=300)]


class Revision(Struct, frozen=True, kw_only=True):
    """Which configuration is meant, for whom, and why.

    Attributes:
        device: The base topic of the device that it is for.
        sequence: Rises with each that a device is sent; both phases of one have the same.
        cohort: Which devices it goes to together, such as ``2 of 3``.
        sha256: Of the text of the configuration.
        commit: The commit in which it stands.
        reason: Why it is sent, such as the subject of that commit.
    """

    v: Literal[1] = 1
    device: _Name
    sequence: Annotated[int, Meta(ge=0, lt=2**62)]
    phase: Phase
    cohort: _Name
    sha256: _Name
    commit: _Name
    reason: _Name


class Desired(Revision, Struct, frozen=True, kw_only=True):
    """What a device shall run; the sections that the text lacks stay as the device has them."""

    configuration: str


class Differences(Struct, frozen=True, kw_only=True):
    """What other decisions a configuration makes over what a device has recorded.

    Attributes:
        ago_s: How long ago the recording ended.
        differing: In how many cycles a command or an event is another one.
        events: How many events of each source come, go or come at another time, such as ``raised added``.
        outputs: In how many cycles each output has another command.
    """

    recording: str
    ago_s: float
    minutes: float
    cycles: int
    differing: int
    events: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    outputs: Mapping[str, int] = field(default_factory=dict)

    @property
    def percent(self) -> float:
        """The share of the decisions that differ."""
        return 100 * self.differing / self.cycles if self.cycles else 0.0


class Trial(Struct, frozen=True, kw_only=True):
    """What came of a trial.

    Attributes:
        refusal: Why the configuration cannot be used; empty if it can.
        settings: The sections that it changes, other than rules and tests.
        motion: What it changes that moves something.
        needs_restart: Whether a reload cannot apply it.
        running_sha256: By which the run knows it, without its secrets.
        warnings: Those that the present configuration does not have.
        tests: How many of its tests passed.
        not_replayed: Why nothing was replayed; empty if something was.
    """

    refusal: str = ""
    settings: tuple[str, ...] = ()
    motion: tuple[str, ...] = ()
    needs_restart: bool = False
    running_sha256: str = ""
    warnings: tuple[str, ...] = ()
    tests: int = 0
    differences: Differences | None = None
    not_replayed: str = ""


class FleetOutcome(Struct, frozen=True, kw_only=True):
    """What became of a desired configuration; `by` has signed it, and `at` is by the clock of the device."""

    revision: Revision
    status: Status
    by: str
    at: str = ""
    sentence: str = ""
    trial: Trial | None = None


class Rejection(Struct, frozen=True):
    """The newest message that is none of an allowed signer for this device now, and how many there were."""

    message_sha256: str = ""
    sentence: str = ""
    count: int = 0


class FleetReport(Struct, frozen=True, kw_only=True):
    """What a device says of its configuration.

    Attributes:
        sha256: Of its file.
        applied: What was applied last; None if nothing ever was.
        is_edited: Whether the file was changed on the device since.
        newest: What became of the newest that was sent.
        clock: What is wrong with its clock.
    """

    v: int = 1
    sha256: str = ""
    applied: FleetOutcome | None = None
    is_edited: bool = False
    newest: FleetOutcome | None = None
    rejected: Rejection = Rejection()
    clock: str = ""

    def why_not(self) -> str:
        """Say why the device does not run what it was sent last; empty if it does, or was never sent anything."""
        newest = self.newest
        if newest is not None and newest.status != "applied":
            return f"{newest.status}: {newest.sentence}" if newest.sentence else f"{newest.status}, and not applied"
        return "its file was edited on the device since" if self.is_edited else ""

    def runs(self, sha256: str) -> bool:
        """Return whether the device runs a configuration that was sent with this SHA-256."""
        return self.applied is not None and self.applied.revision.sha256 == sha256 and not self.why_not()
