"""Every check of the analysis, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from stadimeter.config.analysis.bands import band_errors
from stadimeter.config.analysis.holding import holding_errors, holding_warnings
from stadimeter.config.analysis.promises import promise_errors, promise_warnings
from stadimeter.config.analysis.references import reference_errors
from stadimeter.config.analysis.subject import Subject, subject_of
from stadimeter.config.analysis.timing import timing_warnings
from stadimeter.config.analysis.writers import overlap_warnings, priority_errors, shadow_errors, shadow_warnings
from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding

Check = Callable[[Subject], Iterator[Finding]]

_ERRORS: tuple[Check, ...] = (band_errors, holding_errors, priority_errors, shadow_errors, promise_errors)
_WARNINGS: tuple[Check, ...] = (holding_warnings, shadow_warnings, overlap_warnings, timing_warnings, promise_warnings)


def analysis_errors(draft: Draft) -> Iterator[Finding]:
    """Find what makes rules unusable together.

    Args:
        draft: The configuration as far as it could be read.
    """
    yield from reference_errors(draft)
    subject = subject_of(draft)
    for check in _ERRORS:
        yield from check(subject)


def analysis_warnings(draft: Draft) -> Iterator[Finding]:
    """Find what rules are allowed to say and hardly mean.

    Args:
        draft: The configuration as far as it could be read.
    """
    subject = subject_of(draft)
    for check in _WARNINGS:
        yield from check(subject)
