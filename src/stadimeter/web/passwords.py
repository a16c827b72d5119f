"""The passwords of the page: a file of their own, which holds their hashes and the key that signs sessions."""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stadimeter.errors import PageError
from stadimeter.web.routes import Right

# In characters. Longer ones would cost the time of whoever is asked, and no one types them.
MIN_CHARACTERS = 8
MAX_CHARACTERS = 500

# What OWASP recommends for 8 MiB of memory (Password Storage Cheat Sheet): half a second on a Raspberry Pi 4.
SCRYPT = {"n": 2**13, "r": 8, "p": 10}

SERVICE_FOLDER = Path("/var/lib/stadimeter")
NAMES = {"operate": Right.OPERATE, "read": Right.READ}


@dataclass(frozen=True, slots=True)
class Passwords:
    """What the file holds.

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
        """Return what a password opens; `Right.OPEN`, which is nothing, if it is wrong. Takes long on purpose."""
        tried = self.hash_of(password)
        found = [NAMES[name] for name, hashed in self.hashes.items() if hmac.compare_digest(tried, hashed)]
        return max(found, default=Right.OPEN)

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
        """Return what the file holds; None without a file. `PageError` if it cannot be read: no one may enter then."""
        try:
            found = self.path.stat()
            seen = (found.st_mtime_ns, found.st_ino, found.st_size)
            if seen != self._read_as:
                self._passwords = _parsed(self.path.read_bytes())
                self._read_as = seen
        except FileNotFoundError:
            self._passwords, self._read_as = None, None
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


def _parsed(text: bytes) -> Passwords:
    found = json.loads(text)
    return Passwords(
        {name: int(found["scrypt"][name]) for name in SCRYPT},
        bytes.fromhex(found["salt"]),
        bytes.fromhex(found["key"]),
        {name: bytes.fromhex(found[name]) for name in NAMES if name in found},
    )


def _write(path: Path, passwords: Passwords) -> None:
    told: dict[str, Any] = {"scrypt": passwords.scrypt, "salt": passwords.salt.hex(), "key": passwords.key.hex()}
    told |= {name: hashed.hex() for name, hashed in passwords.hashes.items()}
    try:
        replace_file(path, json.dumps(told))
    except OSError as error:
        raise PageError(400, "password", f"{path}: cannot be written: {error.strerror or error}") from error


def replace_file(path: Path, text: str) -> None:
    """Replace a file at once. It belongs to the owner of its folder, also where root writes it for a service."""
    with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=f".{path.name}-", delete=False) as file:
        try:
            file.write(text + "\n")
            file.flush()
            os.fsync(file.fileno())
            owner = path.parent.stat()
            if os.getuid() == 0:
                os.chown(file.fileno(), owner.st_uid, owner.st_gid)
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
