"""The notifier that reaches every service that the library `apprise` knows: telephones, chats, mail and many more."""

from __future__ import annotations

import inspect
import logging
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Self
from urllib.parse import unquote

from msgspec import Struct
from pydantic import BeforeValidator, SecretStr, model_validator

from stadimeter.config.addresses import address_in
from stadimeter.config.extras import missing
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.secrets import HIDDEN
from stadimeter.config.units import FilePath
from stadimeter.core.decision import Severity, first_to_go
from stadimeter.core.message import Notification
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverUnavailableError
from stadimeter.messaging.protocol import BackOff, Patience

# The names that apprise has for each severity.
KINDS = {Severity.INFO: "info", Severity.WARNING: "warning", Severity.ALARM: "failure", Severity.SAFETY: "failure"}

# The end of a run may take two seconds in all.
PATIENCE = Patience(goodbye_s=0.6)

_MAX_REASON_CHARACTERS = 200
_SECRET = re.compile(r"[^/:@?&=,;\s]{3,}")


def _has_service(url: object) -> object:
    """Refuse what is no URL at all, without repeating it."""
    if not isinstance(url, str) or not re.match(r"[a-z][a-z0-9+.-]*://", url, re.IGNORECASE):
        raise ValueError(
            "this is not the URL of a service; apprise's begin such as 'ntfys://', 'tgram://', 'mailtos://'"
        )
    return url


# For how long a notification is tried.
RETRY_FOR_S = 600.0


class AppriseOptions(DriverOptions):
    """The options of notifications by apprise: mail, chats, telephones. Needs `pip install 'stadimeter[notify]'`."""

    url: Annotated[SecretStr, BeforeValidator(_has_service)] | None = None
    """The service, as apprise writes it; see https://github.com/caronc/apprise/wiki. It mostly holds a secret: prefer
    `url_file`."""
    url_file: FilePath | None = None
    """A text file with the URL on its first line. It may be a systemd credential."""

    @model_validator(mode="after")
    def _one_place_only(self) -> Self:
        if (self.url is None) is (self.url_file is None):
            raise ValueError("a notifier needs either url or url_file")
        return self

    def build(self, context: DriverContext) -> AppriseNotifier:
        """Return the notifier."""
        return AppriseNotifier(self, context.name)

    def lacks(self) -> tuple[str, ...]:
        """Check whether apprise is missing."""
        return (trouble,) if (trouble := missing("notify")) else ()


class AppriseNotifier:
    """Sends notifications to people through one service."""

    def __init__(self, options: AppriseOptions, name: str, patience: Patience = PATIENCE) -> None:
        self._options = options
        self._name = name
        self._patience = patience
        self._service: Any = None
        self._secrets: frozenset[str] = frozenset()
        self._delivery: Delivery | None = None

    @property
    def given_up(self) -> int:
        """Number of notifications that were given up: the service did not take them in time, or too many waited."""
        return self._delivery.given_up if self._delivery is not None else 0

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that were neither taken nor given up, oldest first."""
        return self._delivery.undelivered() if self._delivery is not None else ()

    def open(self) -> None:
        """Load apprise and understand the URL. Nothing is sent yet."""
        if self._delivery is not None:
            return
        url = self._url()
        self._service = _service(url, self._name)
        address = url.partition("://")[2]
        self._secrets = frozenset(_SECRET.findall(f"{address} {unquote(address)}"))
        self._delivery = Delivery(self._deliver, RETRY_FOR_S, self._patience)
        self._delivery.start()

    def notify(self, notification: Notification) -> None:
        """Hand a notification over and return at once."""
        if self._delivery is None or self._delivery.is_stopping:
            raise DeviceClosedError(f"the notifier '{self._name}' is not open; open it first")
        self._delivery.add(notification)

    def trouble(self) -> str:
        """Return in words what is wrong, or an empty string if everything was delivered so far."""
        if self._delivery is None or self._delivery.is_stopping:
            return f"the notifier '{self._name}' is not open"
        words = self._delivery.trouble()
        return f"the notifier '{self._name}': {words}" if words else ""

    def close(self) -> None:
        """Wait a moment at most for what is on its way, and let go. What is left over is `undelivered`."""
        if self._delivery is not None:
            self._delivery.stop()

    def _url(self) -> str:
        url = (
            self._options.url.get_secret_value()
            if self._options.url
            else address_in(self._options.url_file or Path(), "ntfys://…")
        )
        if url == HIDDEN:
            raise DeviceOpenError("its URL was taken out when the configuration was recorded; write url_file with it")
        return url

    def _deliver(self, notification: Notification) -> str:
        """Send one notification; return why that failed, without any secret."""
        with _overheard() as words:
            try:
                if self._service.notify(
                    title=notification.title,
                    body=notification.body,
                    notify_type=KINDS[notification.severity],
                    body_format="text",  # services that speak HTML or Markdown must not take it for that
                ):
                    return ""
            except BaseException as error:  # noqa: BLE001 - a hundred services, and none may end the thread
                words.append(f"{type(error).__name__}: {error}")
        return self._masked(words[-1] if words else "the service did not take the notification")

    def _masked(self, words: str) -> str:
        for secret in sorted(self._secrets, key=len, reverse=True):
            words = words.replace(secret, "…")
        return " ".join(words.split())[:_MAX_REASON_CHARACTERS].rstrip(".")


def _service(url: str, name: str) -> Any:
    try:
        from apprise import Apprise, AppriseAsset  # noqa: PLC0415 - optional, and slow to load
    except ImportError as error:
        raise DriverUnavailableError(f"the notifier '{name}' needs apprise: {missing('notify') or error}") from error
    settings: dict[str, Any] = {"async_mode": False}
    if "service_timeout" in inspect.signature(AppriseAsset).parameters:
        settings["service_timeout"] = 0  # else it sends in threads of its own, which the end of the program waits for
    service = Apprise(asset=AppriseAsset(**settings))
    with _overheard():
        is_known = service.add(url)
    if not is_known:
        scheme = url.partition("://")[0]
        raise DeviceOpenError(f"apprise does not understand the URL of '{name}' ({scheme}://…); see its documentation")
    return service


class _Ear(logging.Handler):
    """Keeps what apprise says in one thread."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.words: list[str] = []
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        if record.thread == self._thread:
            self.words.append(record.getMessage())


@contextmanager
def _overheard() -> Iterator[list[str]]:
    """Collect the warnings of apprise: they say why something failed, and would disturb a live view."""
    ear = _Ear()
    logger = logging.getLogger("apprise")
    logger.addHandler(ear)
    try:
        yield ear.words
    finally:
        logger.removeHandler(ear)


# More than this do not wait: then the oldest of what matters least is given up for the newest.
QUEUE_MAX = 100


class _PendingNotification(Struct, frozen=True):
    """A notification, and until when it is tried."""

    notification: Notification
    until_s: float


class Delivery:
    """Delivers notifications one after the other, in order, and tries again what failed.

    Args:
        deliver: Hands one notification to the service; returns why it could not, or an empty string. It may take its
            time, and is always called in the delivery's own thread.

    Attributes:
        given_up: How many it will not be asked again, since it did not take them in time or too many waited.
        is_stopping: Whether it takes no more.
    """

    def __init__(self, deliver: Callable[[Notification], str], retry_s: float, patience: Patience) -> None:
        self.given_up = 0
        self._deliver = deliver
        self._retry_s = retry_s
        self._patience = patience
        self._pauses = BackOff(patience)
        self._waiting: deque[_PendingNotification] = deque()
        self._trying: _PendingNotification | None = None
        self._left: list[_PendingNotification] = []
        self._changed = threading.Condition()
        self.is_stopping = False
        self._reason = ""
        self._pause_s = 0.0
        self._thread = threading.Thread(target=self._work, name="notifications", daemon=True)

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def add(self, notification: Notification) -> None:
        """Let a notification wait for its turn. Returns at once."""
        with self._changed:
            severities = (each.notification.severity for each in self._waiting)
            if len(self._waiting) >= QUEUE_MAX and (last := first_to_go(severities)) is not None:
                del self._waiting[last]
                self._give_up(self._reason or "too many were waiting")
            self._waiting.append(_PendingNotification(notification, time.monotonic() + self._retry_s))
            self._changed.notify()

    def trouble(self) -> str:
        """Describe what is wrong, in words without line breaks; empty if the newest attempt succeeded."""
        with self._changed:
            if not self._reason:
                return ""
            given_up = f"; given up so far: {self.given_up}" if self.given_up else ""
            if not self._waiting:
                return f"{self._reason}{given_up}"
            return f"{self._reason}; trying again in {self._pause_s:g} s; waiting: {len(self._waiting)}{given_up}"

    def stop(self) -> None:
        """Give what waits one last chance, for a moment. What is left over is `undelivered`."""
        with self._changed:
            self.is_stopping = True
            self._changed.notify()
        self._thread.join(self._patience.goodbye_s)

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that were neither taken nor given up, oldest first."""
        with self._changed:
            trying = [self._trying] if self._trying else []
            return tuple(each.notification for each in (*self._left, *trying, *self._waiting))

    def _give_up(self, reason: str) -> None:
        self.given_up += 1
        self._reason = reason

    def _work(self) -> None:
        while (trying := self._next()) is not None:
            reason = self._deliver(trying.notification)
            with self._changed:
                self._note(trying, reason)

    def _next(self) -> _PendingNotification | None:
        """Wait until there is something to deliver; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self.is_stopping)
            self._trying = self._waiting.popleft() if self._waiting else None
            return self._trying

    def _note(self, tried: _PendingNotification, reason: str) -> None:
        """Take in what became of an attempt, and pause after one that failed."""
        self._trying = None
        if not reason:
            self._reason = ""
            self._pauses.reset()
        elif time.monotonic() >= tried.until_s:
            self._give_up(reason)
        elif self.is_stopping:
            self._left.append(tried)
        else:
            self._reason = reason
            self._waiting.appendleft(tried)
            self._pause_s = min(self._pauses.next_s(), self._patience.alarm_pause_s)
            self._changed.wait_for(lambda: self.is_stopping, self._pause_s)
