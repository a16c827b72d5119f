"""When a site was certified, and whether its configuration is the same since, as `status` says; it loads little."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from msgspec import Struct

from stadimeter.app.exact_json import decode
from stadimeter.config.files import JSON_MAX_BYTES, read_untrusted_text
from stadimeter.errors import ConfigError, UnreadableError

# The endings of the two files: the certificate, and what was measured for one that is not finished.
CERTIFICATE, PLACEMENTS = ".certificate.json", ".placements.json"

CONFIGURATION = "configuration"

# How much of a SHA-256 a certificate shows.
FINGERPRINT = 16

_Kind = TypeVar("_Kind")


class CertificateStamp(Struct, frozen=True, kw_only=True):
    """The subject of a certificate.

    Attributes:
        about: Fingerprints of the camera model, of the target's size and of the whole configuration.
        date: When, in local time.
    """

    about: dict[str, str]
    date: str = ""


def read_beside(configuration: Path, ending: str, kind: type[_Kind]) -> _Kind | None:
    """Return the content of a file of that ending beside a configuration; None if there is none.

    Raises:
        ConfigError: It cannot be read.
    """
    file = configuration.with_suffix(ending)
    try:
        return decode(read_untrusted_text(file, JSON_MAX_BYTES), kind)
    except (UnreadableError, ValueError) as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise ConfigError(f"{file} cannot be read: {error}; delete it, or certify with --anew") from error


def certificate_status(configuration: Path, digest: str) -> dict[str, Any] | None:
    """Describe the certificate beside a configuration; None if there is none.

    Args:
        digest: The SHA-256 of the configuration that a run goes by.
    """
    try:
        made = read_beside(configuration, CERTIFICATE, CertificateStamp)
    except ConfigError as error:
        return {"date": "", "is_unchanged": False, "words": str(error)}
    if made is None:
        return None
    is_unchanged = digest[:FINGERPRINT] == made.about.get(CONFIGURATION)
    changed = "changed since: `stadimeter check` says whether it still counts"
    words = f"certified on {made.date}; the configuration {'is the same since' if is_unchanged else changed}"
    return {"date": made.date, "is_unchanged": is_unchanged, "words": words}
