"""Rights of access: hosts that we are known by, sessions in signed cookies, and requests from a page of ours."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import secrets
import socket
import time
from collections.abc import Callable, Iterable
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from stadimeter.errors import PageError
from stadimeter.web.answers import as_error, as_json
from stadimeter.web.passwords import Attempts, PasswordFile, Passwords
from stadimeter.web.routes import PAGE_OPERATIONS, TOKENS, PageOperation, Right

# A session lasts this long, on the wall clock.
SESSION_S = 14 * 24 * 3600

# As many logins may wait for each other: one password is hashed at a time. After a wrong one the next waits so long: a
# network of computers guesses no faster than one.
LOGINS_MAX, AFTER_WRONG_S = 4, 2.0

# Of every answer, unless it says otherwise.
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with `no-referrer`, forms would be sent with the origin `null`
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

OPEN_PATHS = frozenset(each.path for each in PAGE_OPERATIONS if each.right is Right.OPEN)


class Access:
    """Decides who may what.

    Args:
        file: Where the passwords are.
        listens: The address and the port that we listen at.
        allowed_hosts: Names by which we are known, besides our own.
        wall_clock: Seconds since 1970.
    """

    def __init__(
        self,
        file: PasswordFile,
        listens: tuple[str, int],
        allowed_hosts: Iterable[str] = (),
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self.file = file
        self.attempts = Attempts()
        self._ended: set[str] = set()  # cookies of sessions that somebody has logged out of
        self._is_local = is_loopback(listens[0])
        self._cookie = f"stadimeter-{listens[1]}"  # two pages of one computer share the cookies of its name
        self._hosts = _own_names() | {each.lower().rstrip(".") for each in allowed_hosts}
        self._unix_s = wall_clock
        self._hashing = asyncio.Lock()
        self._logins = 0

    @property
    def needs_password(self) -> bool:
        """True if everyone must log in."""
        return not self._is_local or self.file.passwords() is not None

    def check_host(self, scope: Scope) -> None:
        """See that the request is meant for us; else any site could have its name lead here, and ask as us."""
        given = Headers(scope=scope).getlist("host")
        name = _host_name(given[0]) if len(given) == 1 else ""
        if name in self._hosts or _is_address_of_ours(name, scope):
            return
        words = f"this page is not known as {name!r}; if that name is yours, write it into `allowed_hosts` of `[web]`"
        raise PageError(400, "unknown-host", words if name else "a request names one host")

    def right_of(self, scope: Scope) -> Right:
        """Return the right that the sender of a request has."""
        passwords = self.file.passwords()
        if passwords is None:
            return Right.OPERATE if self._is_local else Right.OPEN
        headers = Headers(scope=scope)
        if scope["path"] in TOKENS and _has_token(passwords.token(TOKENS[scope["path"]]), headers):
            return Right.READ
        return self._session(passwords, headers)[0]

    def may_read(self, scope: Scope) -> bool:
        """Check whether the reader of a stream may still read: it may have begun before that right ended."""
        try:
            return self.right_of(scope) >= Right.READ
        except PageError:
            return False

    def check(self, operation: PageOperation, scope: Scope) -> None:
        """Check that the session has the right for an operation, and that a page of ours asks for a change."""
        if scope["right"] < operation.right:
            raise PageError(403, "not-allowed", "this needs the password for operating; you may only watch")
        if not operation.changes:
            return
        headers = Headers(scope=scope)
        is_form = operation.right is Right.OPEN
        wanted = "application/x-www-form-urlencoded" if is_form else "application/json"
        if headers.get("content-type", "").partition(";")[0].strip().lower() != wanted:
            raise PageError(400, "wrong-content", f"a request that changes something has Content-Type: {wanted}")
        if not _is_from_us(headers):
            raise PageError(403, "wrong-origin", "this comes from another origin, and only the page itself may ask it")

    async def log_in(self, password: str, address: str) -> tuple[Passwords, Right]:
        """Check a password and return what it opens; `PageError` if it is wrong, or was tried too often."""
        passwords = self.file.passwords()
        if passwords is None:
            raise PageError(503, "no-passwords", "no password is set: `stadimeter web --set-password` sets one")
        if self._logins >= LOGINS_MAX:
            raise PageError(429, "too-many-attempts", "others are logging in; try again in a second", {"wait_s": 1})
        self.attempts.begin(address)
        self._logins += 1
        try:
            async with self._hashing:
                right = await asyncio.to_thread(passwords.right_of, password)
                if right is Right.OPEN:
                    await asyncio.sleep(AFTER_WRONG_S)
                    raise PageError(401, "wrong-password", "the password is wrong")
        finally:
            self._logins -= 1
        self.attempts.succeeded(address, forgets=right is Right.OPERATE)
        return passwords, right

    def begin_session(self, response: Response, passwords: Passwords, right: Right, scope: Scope) -> None:
        """Give the browser a cookie that says what it may do, and until when."""
        told = f"{int(right)}.{int(self._unix_s()) + SESSION_S}.{secrets.token_hex(8)}"
        self._set_cookie(response, f"{told}.{_signature(passwords, told)}", SESSION_S, scope)

    def end_session(self, scope: Scope) -> Response:
        """End a session, also for copies of its cookie until the page is started again; return the answer."""
        passwords = self.file.passwords()
        if passwords is not None:
            self._ended.add(self._session(passwords, Headers(scope=scope))[1])
        response = as_json({})
        self._set_cookie(response, "", 0, scope)
        return response

    def _set_cookie(self, response: Response, value: str, age_s: int, scope: Scope) -> None:
        through_proxy = Headers(scope=scope).get("x-forwarded-proto") == "https"
        is_secure = scope["scheme"] == "https" or through_proxy
        response.set_cookie(
            self._cookie, value, max_age=age_s, path="/", secure=is_secure, httponly=True, samesite="strict"
        )

    def _session(self, passwords: Passwords, headers: Headers) -> tuple[Right, str]:
        """Return the right of a session, and its cookie."""
        # Not that of `http.cookies`, which reads none where one of another program on this computer is odd to it.
        cookie = cookie_parser(headers.get("cookie", "")).get(self._cookie, "")
        told, _, signature = cookie.rpartition(".")
        if not hmac.compare_digest(signature.encode(), _signature(passwords, told).encode()):
            return Right.OPEN, cookie
        right, until_s, _ = told.split(".")
        is_over = self._unix_s() >= int(until_s) or cookie in self._ended
        return Right.OPEN if is_over else Right(int(right)), cookie


class AccessGuard:
    """Stands before the application: sets headers, and lets no one past the login without the right."""

    def __init__(self, app: ASGIApp, access: Access, ask_to_log_in: Callable[[PageError], Response]) -> None:
        self._app = app
        self._access = access
        self._ask = ask_to_log_in

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            self._admit(scope)
        except PageError as error:
            is_page = scope["path"] == "/" and error.status == 401
            await (self._ask(error) if is_page else as_error(error))(scope, receive, with_headers)
        else:
            await self._app(scope, receive, with_headers)

    def _admit(self, scope: Scope) -> None:
        self._access.check_host(scope)
        scope["right"] = self._access.right_of(scope)
        if scope["right"] is Right.OPEN and scope["path"] not in OPEN_PATHS:
            raise PageError(401, "not-logged-in", "log in first")


def is_loopback(address: str) -> bool:
    """Check whether an address leads to this computer alone."""
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def shown_address(address: str, port: int) -> str:
    """Return where a browser finds us: an address, or our name on the local network if it may be any address."""
    if ip_address(address).is_unspecified:
        return f"{socket.gethostname().partition('.')[0]}.local:{port}"
    return f"[{address}]:{port}" if ":" in address else f"{address}:{port}"


def _own_names() -> set[str]:
    name = socket.gethostname().lower()
    short = name.partition(".")[0]
    return {"localhost", name, short, f"{short}.local"}


def _host_name(host: str) -> str:
    """Return the name of a host without its port, and without the brackets of version 6."""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""


def _is_address_of_ours(name: str, scope: Scope) -> bool:
    """Check whether it is an address, and the one that the connection came in at, or of the loopback."""
    try:
        given = ip_address(name)
    except ValueError:
        return False
    try:
        ours = ip_address((scope.get("server") or ("",))[0].partition("%")[0])
    except ValueError:
        return given.is_loopback
    return given.is_loopback or given in {ours, getattr(ours, "ipv4_mapped", None)}


def _is_from_us(headers: Headers) -> bool:
    origin = headers.get("origin")
    if origin is not None:
        return origin.partition("://")[2].lower() == headers.get("host", "").lower() != ""
    return headers.get("sec-fetch-site") == "same-origin"


def _has_token(token: str, headers: Headers) -> bool:
    scheme, _, given = headers.get("authorization", "").partition(" ")
    is_right = hmac.compare_digest(given.strip().encode(), token.encode())
    return scheme.lower() == "bearer" and is_right


def _signature(passwords: Passwords, told: str) -> str:
    return hmac.new(passwords.key, told.encode("utf-8", "replace"), hashlib.sha256).hexdigest()
