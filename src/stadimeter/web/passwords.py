"""The passwords of the page, in a file with their hashes and the key that signs sessions; and sessions that were ended.

The cookies of ended sessions are signed, and would open the page until they end by themselves.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import hmac
import json
import os
import secrets
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable
from ipaddress import IPv6Address, ip_address, ip_network
from math import ceil
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct, field
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

# Of so many sessions of a right it is remembered that they were ended. One more ends others, and lets none go on.
ENDED_MAX = 1000


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
    told: dict[str, Any] = {"scrypt": passwords.scrypt, "salt": passwords.salt.hex(), "key": passwords.key.hex()}
    told |= {name: hashed.hex() for name, hashed in passwords.hashes.items()}
    try:
        replace_file(path, json.dumps(told))
    except OSError as error:
        raise PageError(400, "password", f"{path}: cannot be written: {error.strerror or error}") from error


def replace_file(path: Path, text: str) -> None:
    """Replace a file at once. It belongs to the owner of its folder, also where root writes it for a service.

    Raises:
        OSError: It cannot be written there, or is something else than a file, which is left alone.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no regular file, and is left alone", str(path))
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


class Session(Struct, frozen=True):
    """The contents of a cookie: what it opens, until when in seconds since 1970, and which session it is."""

    right: Right
    until_s: int
    name: str


class _OfRight(Struct):
    """The ended sessions of one right, each with its end; and the end up to which every one counts as ended."""

    ended: dict[str, int] = field(default_factory=dict)
    floor_s: int = 0

    def add(self, session: Session, now_s: float) -> None:
        self.ended = {name: until_s for name, until_s in self.ended.items() if until_s > now_s}
        self.ended[session.name] = session.until_s
        while len(self.ended) > ENDED_MAX:
            first = min(self.ended, key=self.ended.__getitem__)
            self.floor_s = max(self.floor_s, self.ended.pop(first))


class EndedSessions:
    """Remembers ended sessions, in a file beside the passwords: a restart of the page opens none of them again.

    Args:
        path: The file; it is made when it is first needed.
        unix_s: Seconds since 1970.
    """

    def __init__(self, path: Path, unix_s: Callable[[], float]) -> None:
        self.path = path
        self._unix_s = unix_s
        self._read_as: tuple[int, ...] | None = None
        self._of: dict[Right, _OfRight] = {}
        self._writing = asyncio.Lock()

    def has(self, session: Session) -> bool:
        """Check whether a session was ended; `PageError` if that cannot be known: none goes on then."""
        self._read()
        ended = self._of.get(session.right)
        return ended is not None and (session.until_s <= ended.floor_s or session.name in ended.ended)

    async def add(self, session: Session) -> None:
        """End a session, at once; `PageError` if the file cannot be written, so that a restart would revive it."""
        async with self._writing:
            self._read()
            self._of.setdefault(session.right, _OfRight()).add(session, self._unix_s())
            try:
                await asyncio.to_thread(replace_file, self.path, msgspec.json.encode(self._of).decode())
            except OSError as error:
                words = f"you are logged out until the page restarts: {self.path} cannot be written: {error.strerror}"
                raise PageError(503, "not-written", words) from error

    def _read(self) -> None:
        try:
            seen = _signature(self.path)
            if seen is not None and seen != self._read_as:
                self._of = msgspec.json.decode(self.path.read_bytes(), type=dict[Right, _OfRight])
                self._read_as = seen
        except (OSError, ValueError) as error:
            words = f"{self.path}: cannot be read; delete it, and set the password anew to end all sessions"
            raise PageError(503, "no-sessions", words) from error


def _signature(path: Path) -> tuple[int, ...] | None:
    """Return a signature that changes with a file; None if there is none."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_mtime_ns, found.st_ino, found.st_size


# Limits on how often a password may be tried: in a row from one address, and a minute in all ------


# So many failures in a row cost no time. Each further one doubles the wait.
FREE = 5

# After this long without a failure, those before count no more.
FIRST_WAIT_S, MAX_WAIT_S = 10.0, 900.0
FORGOTTEN_S = 24 * 3600.0

# So many attempts at once, and then one in so much time, are taken from all addresses together that are not known: a
# network of computers guesses no faster than one.
IN_ALL, EVERY_S = 30, 2.0

# So long an attempt waits for its turn among them, before it is refused. So five wait at most.
TURN_MAX_S = 10.0

# Of so many addresses the failures are remembered; the oldest is forgotten first.
ADDRESSES_MAX = 1000

# Of so many it is remembered that somebody who may operate has logged in from there.
KNOWN_MAX = 100


class Attempts:
    """Counts failures.

    Args:
        clock: Seconds, of any origin.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._known: OrderedDict[str, None] = OrderedDict()
        self._paid_until_s = 0.0

    def knows(self, address: str) -> bool:
        """Check whether an operator has logged in from there: attempts from elsewhere do not hold them up."""
        return network_of(address) in self._known

    def begin(self, address: str) -> float:
        """Count an attempt as failed until it has succeeded; return for how long it waits for its turn.

        Raises `PageError`, which says how long to wait, if it is too early.
        """
        now_s, of = self._clock(), network_of(address)
        count, until_s = self._failures.get(of, (0, now_s))
        if now_s > until_s + FORGOTTEN_S:
            count = 0
        turn_s = 0.0 if of in self._known else self._turn_s(now_s)
        left_s = ceil(max(until_s - now_s, turn_s - TURN_MAX_S))
        if left_s > 0:
            words = f"too many wrong passwords; try again in {left_s} s"
            raise PageError(429, "too-many-attempts", words, {"wait_s": left_s})
        if of not in self._known:
            self._paid_until_s = max(self._paid_until_s, now_s) + EVERY_S
        count += 1
        doubled = 2.0 ** min(count - FREE, 20)
        wait_s = min(MAX_WAIT_S, FIRST_WAIT_S * doubled) if count >= FREE else 0.0
        self._failures[of] = (count, now_s + wait_s)
        self._failures.move_to_end(of)
        while len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)
        return turn_s

    def _turn_s(self, now_s: float) -> float:
        return max(0.0, self._paid_until_s - now_s - (IN_ALL - 1) * EVERY_S)

    def succeeded(self, address: str, *, forgets: bool = True) -> None:
        """Take back the attempt that was none, and forget the failures of its address.

        Args:
            forgets: Whether those are forgotten at once, and the address is known from now on. Not for a password that
                there is more to gain than: its owner could guess that other one without a wait, with theirs in
                between.
        """
        of = network_of(address)
        count, _ = self._failures.pop(of, (1, 0.0))
        if count > 1 and not forgets:
            self._failures[of] = (count - 1, self._clock())
        if of not in self._known:
            self._paid_until_s -= EVERY_S
        if forgets:
            self._known[of] = None
            self._known.move_to_end(of)
        if len(self._known) > KNOWN_MAX:
            self._known.popitem(last=False)


def network_of(address: str) -> str:
    """Return the range of addresses that one computer may have: of version 6, any of its network."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, IPv6Address) and found.ipv4_mapped is None:
        return str(ip_network((found, 64), strict=False))
    return str(getattr(found, "ipv4_mapped", None) or found)
