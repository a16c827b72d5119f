"""Passwords of the page, in a file of their hashes and the key that signs sessions; and how often one may be tried."""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable
from math import ceil
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.errors import PageError
from stadimeter.web.routes import Right

# In characters. Longer ones would cost the time of whoever is asked, and no one types them.
MIN_CHARACTERS = 8
MAX_CHARACTERS = 500

# What OWASP recommends for 8 MiB of memory (Password Storage Cheat Sheet): half a second on a Raspberry Pi 4.
SCRYPT = {"n": 2**13, "r": 8, "p": 10}

SERVICE_FOLDER = Path("/var/lib/stadimeter")
NAMES = {"operate": Right.OPERATE, "read": Right.READ}


class Passwords(Struct, frozen=True):
    """The contents of the file.

    Attributes:
        scrypt: The parameters that its hashes were made with.
        salt: One for both hashes, so that a login costs one hash.
        key: Signs the cookies of sessions. A new password brings a new key, which ends all sessions.
        hashes: By the name of the right.
    """

    scrypt: dict[str, int]
    salt: bytes
    key: bytes
    hashes: dict[str, bytes]

    def right_of(self, password: str) -> Right:
        """Return the right that a password opens; `Right.OPEN`, nothing, if it is wrong. Takes long on purpose."""
        tried = self.hash_of(password)
        found = [NAMES[name] for name, hashed in self.hashes.items() if hmac.compare_digest(tried, hashed)]
        return max(found, default=Right.OPEN)

    def token(self, what: str) -> str:
        """Return the token that opens only metrics, or alarms. Not by the hash that signs cookies: it can be none."""
        return hmac.new(self.key, what.encode(), hashlib.sha3_256).hexdigest()

    def hash_of(self, password: str) -> bytes:
        """Return the hash of a password."""
        memory = 2 * 128 * self.scrypt["r"] * (self.scrypt["n"] + self.scrypt["p"])
        return hashlib.scrypt(password.encode("utf-8", "replace"), salt=self.salt, maxmem=memory, **self.scrypt)


class PasswordFile:
    """Knows the passwords, also when they are changed while the page is served."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read_as: tuple[int, ...] | None = None
        self._passwords: Passwords | None = None

    def passwords(self) -> Passwords | None:
        """Return the contents of the file; None without one. `PageError` if it cannot be read: no one enters then."""
        try:
            seen = _signature(self.path)
            if seen != self._read_as:
                self._passwords = _parse_passwords(self.path.read_bytes()) if seen is not None else None
                self._read_as = seen
        except (OSError, ValueError, KeyError, TypeError) as error:
            why = (
                error.strerror
                if isinstance(error, OSError)
                else "it is no password file; delete it, and set the password anew"
            )
            raise PageError(503, "no-passwords", f"{self.path}: cannot be read: {why}") from error
        return self._passwords

    def set(self, right: str, password: str) -> None:
        """Set the password of a right, and end all sessions; `PageError` if it is too short, or that of the other."""
        if not MIN_CHARACTERS <= len(password) <= MAX_CHARACTERS:
            raise PageError(400, "password", f"a password has {MIN_CHARACTERS} to {MAX_CHARACTERS} characters")
        before = self.passwords() or Passwords(SCRYPT, secrets.token_bytes(16), b"", {})
        hashed = before.hash_of(password)
        if any(hashed == other for name, other in before.hashes.items() if name != right):
            raise PageError(400, "password", "each right needs a password of its own: this one is the other's")
        hashes = {**before.hashes, right: hashed}
        _write(self.path, replace(before, key=secrets.token_bytes(32), hashes=hashes))


def place_of_passwords(configuration: Path | None) -> Path:
    """Return where the passwords are: beside the configuration, or without one where the service has them."""
    if configuration is not None:
        return configuration.with_suffix(".passwords")
    if SERVICE_FOLDER.is_dir():
        return SERVICE_FOLDER / "page.passwords"
    raise PageError(400, "password", "name the CONFIG that the page is for, or give --password-file")


def _parse_passwords(text: bytes) -> Passwords:
    found = json.loads(text)
    return Passwords(
        {name: int(found["scrypt"][name]) for name in SCRYPT},
        bytes.fromhex(found["salt"]),
        bytes.fromhex(found["key"]),
        {name: bytes.fromhex(found[name]) for name in NAMES if name in found},
    )


def _write(path: Path, passwords: Passwords) -> None:
    """Replace the file at once. It belongs to the owner of its folder, also where root writes it for a service."""
    told: dict[str, Any] = {"scrypt": passwords.scrypt, "salt": passwords.salt.hex(), "key": passwords.key.hex()}
    told |= {name: hashed.hex() for name, hashed in passwords.hashes.items()}
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=f".{path.name}-", delete=False) as file:
            json.dump(told, file)
            file.flush()
            os.fsync(file.fileno())
            if os.getuid() == 0:
                owner = path.parent.stat()
                os.chown(file.fileno(), owner.st_uid, owner.st_gid)
            Path(file.name).replace(path)
    except OSError as error:
        raise PageError(400, "password", f"{path}: cannot be written: {error.strerror or error}") from error


def _signature(path: Path) -> tuple[int, ...] | None:
    """Return a signature that changes with a file; None if there is none."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_mtime_ns, found.st_ino, found.st_size


# Limits on how often a password may be tried in a row from one address ---------------------------


# So many failures in a row cost no time. Each further one doubles the wait.
FREE = 5

# After this long without a failure, those before count no more.
FIRST_WAIT_S, MAX_WAIT_S = 10.0, 900.0
FORGOTTEN_S = 24 * 3600.0

# Of so many addresses the failures are remembered; the oldest is forgotten first.
ADDRESSES_MAX = 1000


class Attempts:
    """Counts failures.

    Args:
        clock: Seconds, of any origin.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()

    def begin(self, address: str) -> None:
        """Count an attempt as failed until it has succeeded.

        Raises:
            PageError: It is too early; it says how long to wait.
        """
        now_s = self._clock()
        count, until_s = self._failures.get(address, (0, now_s))
        if now_s > until_s + FORGOTTEN_S:
            count = 0
        left_s = ceil(until_s - now_s)
        if left_s > 0:
            words = f"too many wrong passwords; try again in {left_s} s"
            raise PageError(429, "too-many-attempts", words, {"wait_s": left_s})
        count += 1
        doubled = 2.0 ** min(count - FREE, 20)
        wait_s = min(MAX_WAIT_S, FIRST_WAIT_S * doubled) if count >= FREE else 0.0
        self._failures[address] = (count, now_s + wait_s)
        self._failures.move_to_end(address)
        if len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)

    def succeeded(self, address: str, *, forgets: bool = True) -> None:
        """Take back the attempt that was none, and forget the failures of its address.

        Args:
            forgets: Whether those are forgotten. Not for a password that there is more to gain than: its owner could
                guess that other one without a wait, with theirs in between.
        """
        count, _ = self._failures.pop(address, (1, 0.0))
        if count > 1 and not forgets:
            self._failures[address] = (count - 1, self._clock())
