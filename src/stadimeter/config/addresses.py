"""Addresses of cameras and services: they often hold a password or a token, which no message, view or file may repeat.

User info, parameters and fragment of an address are left out. Drivers name what they talk to by `address_for_people` in
every message; a text in which an address may stand, such as an error with the value of a key, goes through
`words_for_people`.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.config.files import SECRET_MAX_BYTES, read_untrusted_text
from stadimeter.errors import DeviceOpenError, UnreadableError

if TYPE_CHECKING:
    import ssl

# Stands in place of the secret parts of an address.
LEFT_OUT = "…"

# The beginning of the parameters of an address. Some cameras have them in the path: ``/user=me&password=secret``.
_ADDRESS = re.compile(r"""://([^\s"'`<>\\]+)""")
_PARAMETERS = re.compile(r"[?#;]|(?<=/)[^/?#;]*=")

_PAGE = re.compile(r"https?://([\w.-]+|\[[\da-fA-F:]+\])(:\d{1,5})?/?")


def address_for_people(address: str) -> str:
    """Return an address without what may be a secret in it; idempotent.

    Of ``rtsp://me:secret@camera/live?token=abc``, ``rtsp://camera/live?…`` is left.
    """
    scheme, mark, rest = address.partition("://")
    return f"{scheme}{mark}{_for_people(rest)}"


def words_for_people(text: str) -> str:
    """Return a text without what may be a secret in the addresses that stand in it."""
    return _ADDRESS.sub(lambda found: f"://{_for_people(found[1])}", text)


def address_in(file: Path, example: str) -> str:
    """Return the address on the first line of a file, which may be a systemd credential.

    Raises:
        DeviceOpenError: It cannot be read, or no address stands there. The message repeats nothing of it.
    """
    try:
        lines = read_untrusted_text(file, SECRET_MAX_BYTES).strip().splitlines()
    except UnreadableError as error:
        raise DeviceOpenError(f"the file with its address, {file}, cannot be read: {error.reason}") from error
    if not lines or "://" not in lines[0]:
        raise DeviceOpenError(f"the first line of {file} is not an address such as '{example}'")
    return lines[0].strip()


def not_trusted(error: ssl.SSLCertVerificationError, host: str, of_unknown: str) -> str:
    """Say why a certificate is not trusted, and the remedy: by far not every one is of an authority that is not known.

    Args:
        of_unknown: The remedy for one that is.
    """
    now = datetime.now(UTC)
    another_name = f"write as host a name that is in it, in place of '{host}'"
    remedies = {  # by OpenSSL's X509_V_ERR_…
        9: f"this computer's clock says {now:%Y-%m-%d %H:%M} UTC: set it, or wait for the time server",  # not yet valid
        10: f"if it is {now:%Y-%m-%d} today, renew it there, else set this computer's clock",  # has expired
        **dict.fromkeys((62, 64), another_name),  # host name, address
        **dict.fromkeys((2, 18, 19, 20, 21), of_unknown),  # no issuer is known, or it signs itself
    }
    remedy = remedies.get(error.verify_code, "another certificate is needed there")
    return f"is not trusted: {error.verify_message.rstrip('.')}; {remedy}"


def check_page_address(text: object) -> str:
    """Return the address of a page, without a slash at its end; a ValueError if it is none."""
    if not isinstance(text, str) or not _PAGE.fullmatch(text):
        told = address_for_people(str(text))
        raise ValueError(f"{told!r} is not the address of a page, such as 'http://garage.local:8080'")
    return text.rstrip("/")


def _for_people(rest: str) -> str:
    """Return the part behind the scheme of an address. If the password cannot be recognised, nothing is left of it."""
    cut = _PARAMETERS.search(rest)
    before, after = (rest[: cut.start()], rest[cut.start() :]) if cut else (rest, "")
    if "@" in after:  # of a password with such a character, or of an address of mail
        return LEFT_OUT
    place = before.rpartition("@")[2]
    mark = after[0] if after[:1] in {"?", "#", ";"} else ""
    return place + (f"{mark}{LEFT_OUT}" if after else "")
