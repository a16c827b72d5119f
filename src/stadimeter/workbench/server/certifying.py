"""Certifying the site on the page: one placement after the other, and what the certificate says.

What was measured is in a file beside the configuration, so the page, a phone and the terminal go on with the same.
"""

from __future__ import annotations

from typing import Any

from stadimeter.app.certificate import load_certificate
from stadimeter.config.files import PICTURE_MAX_BYTES, read_untrusted
from stadimeter.config.loader import load_configuration
from stadimeter.config.units import parse_length
from stadimeter.errors import ConfigError, NotThereError, UnreadableError
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.site import HTML, SiteSession, describe_placement, describe_reliance, summary_of


@operation
def state(desk: Desk) -> dict[str, Any]:
    """Answer the distances that are left, what was measured, and what the certificate says that there is."""
    session = SiteSession(load_configuration(desk.configuration))
    made = load_certificate(desk.configuration)
    return {
        "left_m": session.propose_m(),
        "placements": [
            {"tape_m": each.tape_m, "is_read": each.is_read, "words": describe_placement(each)}
            for each in session.certificate.placements
        ],
        "certificate": {
            "date": made.date,
            "outdated": session.site.outdated(made),
            "words": list(summary_of(made)),
            "rules": [describe_reliance(each) for each in session.site.reliances(made)],
        }
        if made
        else None,
    }


@operation
def take(desk: Desk, distance: str, sigma: str = "2 mm") -> dict[str, Any]:
    """Watch the target where it is now, for some seconds."""
    try:
        tape_m, sigma_m = parse_length(distance), parse_length(sigma)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    SiteSession(load_configuration(desk.configuration)).take(tape_m, sigma_m)
    return state(desk)


@operation
def finish(desk: Desk) -> dict[str, Any]:
    """Write the certificate from what was measured."""
    SiteSession(load_configuration(desk.configuration)).finish()
    return state(desk)


@operation
def page(desk: Desk) -> DeskReply:
    """Answer the page of the certificate, as it was written."""
    try:
        return DeskReply(attached=read_untrusted(desk.configuration.with_suffix(HTML), PICTURE_MAX_BYTES))
    except UnreadableError as error:
        raise NotThereError(f"there is no certificate of this site to show: {error}") from error
