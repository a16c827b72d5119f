"""What a check found: what was seen, how bad that is, and one remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How bad it is. What cannot be found out is `UNKNOWN`, never fine."""

    FINE = "fine"
    WARNING = "warning"
    WRONG = "wrong"
    UNKNOWN = "not known"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a check found.

    Attributes:
        seen: A phrase without a full stop.
        remedy: What to do about it; empty where there is nothing to do.
    """

    severity: Severity
    seen: str
    remedy: str = ""


def fine(seen: str) -> Diagnosis:
    """Return that all is well."""
    return Diagnosis(Severity.FINE, seen)


def warning(seen: str, remedy: str) -> Diagnosis:
    """Return what may become a problem."""
    return Diagnosis(Severity.WARNING, seen, remedy)


def wrong(seen: str, remedy: str) -> Diagnosis:
    """Return what is wrong."""
    return Diagnosis(Severity.WRONG, seen, remedy)


def unknown(seen: str, remedy: str = "") -> Diagnosis:
    """Return what cannot be found out here."""
    return Diagnosis(Severity.UNKNOWN, seen, remedy)
