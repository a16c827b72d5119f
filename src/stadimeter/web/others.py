"""The pages of other cameras: whether each answers, and which alarms stand there.

This process asks them while a browser looks; a browser asks no page but its own. No answer of ours waits for another
page: it has what is known by now, and how old that is. Each is asked in a thread of its own, which ends with us.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

import msgspec
from msgspec import Struct, field

from stadimeter.errors import PageError
from stadimeter.web.routes import ALARMS_PATH

# One that answers is asked this often, any other less often. What takes longer than the wait is no answer. What is
# older than the last is not of now: a camera that hangs, no browser that has looked for a while, or an answer that
# comes byte by byte. A browser asks once a second, so that an answer is 2 s old at most while all is well.
ASK_EVERY_S, ASK_AGAIN_S, WAIT_S, OLD_S = 0.9, 10.0, 4.0, 3.0
ANSWER_MAX_BYTES = 1024 * 1024


class OtherAlarm(Struct, frozen=True):
    """The parts that are read of an alarm of another page."""

    rule: str
    status: str
    acknowledged: bool
    inhibits: list[str]
    severity: str = ""
    reason: str = ""
    raised_unix_s: float | None = None


class _OtherAlarms(Struct):
    alarms: list[OtherAlarm]


class OtherPage(Struct):
    """A page, and what is known of it.

    Attributes:
        token: What opens its alarms if it has a password.
        state: ``asked`` before an answer, ``live``, ``no-run``, ``refused`` or ``silent``.
        alarms: As they were when it was last live.
        live_s: When that was, on the monotonic clock; None for never.
        next_s: When it is asked next.
    """

    url: str
    token: str = ""
    state: str = "asked"
    words: str = ""
    alarms: list[OtherAlarm] = field(default_factory=list)
    live_s: float | None = None
    next_s: float = -math.inf

    def tell(self, now_s: float) -> dict[str, Any]:
        """Return it as JSON has it."""
        age_s = None if self.live_s is None else round(now_s - self.live_s, 1)
        alarms = msgspec.to_builtins(self.alarms)
        name, state = urlsplit(self.url).netloc, self.state
        if state == "live" and age_s is not None and age_s > OLD_S:
            state = "asked"
        return {
            "url": self.url, "name": name, "state": state, "words": self.words, "age_s": age_s, "alarms": alarms
        }  # fmt: skip

    def ask(self) -> None:
        """Ask it, which may take seconds."""
        try:
            status, body = self._get()
            if status == 200:
                self.alarms, self.live_s = msgspec.json.decode(body, type=_OtherAlarms).alarms, time.monotonic()
                self.state, self.words = "live", ""
            else:
                self.state = "no-run" if status == 503 else "refused"
                self.words = "it wants a token" if status == 401 else msgspec.json.decode(body)["error"]["message"]
        except OSError as error:
            self.state, self.words = "silent", error.strerror or f"no answer: {error}"
        except (ValueError, LookupError, TypeError, OverflowError, HTTPException):
            self.state, self.words = "refused", "what answers there is no page of stadimeter"
        finally:
            self.next_s = time.monotonic() + (ASK_EVERY_S if self.state == "live" else ASK_AGAIN_S)

    def _get(self) -> tuple[int, bytes]:
        """Return the status and the body of its alarms. No redirection is followed: the token is for it alone."""
        to = urlsplit(self.url)
        connection = (HTTPSConnection if to.scheme == "https" else HTTPConnection)(to.netloc, timeout=WAIT_S)
        try:
            secret = {"Authorization": f"Bearer {self.token}"} if self.token else {}
            connection.request("GET", ALARMS_PATH, headers=secret)
            response = connection.getresponse()
            return response.status, response.read(ANSWER_MAX_BYTES)
        finally:
            connection.close()


class Others:
    """Asks other pages, each in its own time.

    Args:
        urls: Those that are named.
        tokens: What opens those with passwords, by their address.
    """

    def __init__(self, urls: Sequence[str], tokens: Mapping[str, str]) -> None:
        self._pages = [OtherPage(url, tokens.get(url, "")) for url in urls]

    def tell(self) -> list[dict[str, Any]]:
        """List what is known of each, at once; and ask those whose turn it is."""
        now_s = time.monotonic()
        for page in self._pages:
            if now_s >= page.next_s:
                page.next_s = math.inf
                Thread(target=page.ask, daemon=True).start()
        return [page.tell(now_s) for page in self._pages]


def read_tokens(path: Path) -> dict[str, str]:
    """Read a file of tokens: on each line an address and its token; `PageError` says which line is none."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, ValueError) as error:
        raise PageError(400, "tokens", f"{path}: cannot be read: {error}") from error
    tokens = {}
    for number, line in enumerate(lines, start=1):
        match line.split():
            case [] | ["#", *_]:
                continue
            case [url, token]:
                tokens[url.rstrip("/")] = token
            case _:
                words = "a line is an address and its token, such as http://garage.local:8080 3f9c…"
                raise PageError(400, "tokens", f"{path}:{number}: {words}")
    return tokens
