"""Answers that the page's process gives itself: its files, logins, sessions, live snapshots, pictures and downloads."""

from __future__ import annotations

import asyncio
import html
import json
import mimetypes
import struct
import time
from collections import defaultdict, deque
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import aclosing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from msgspec import Struct
from starlette.requests import Request
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.staticfiles import StaticFiles

import stadimeter
from stadimeter.errors import PageError
from stadimeter.web.access import Access
from stadimeter.web.answers import Streamed, as_json, as_picture, bounded_body
from stadimeter.web.links import PageAnswer, RunLink, RunProcess, WorkbenchLink, command_of_workbench
from stadimeter.web.passwords import PasswordFile
from stadimeter.web.routes import RUN_WAIT_S, Right

if TYPE_CHECKING:
    from stadimeter.web.others import Others


# Snapshots and pictures of the run, from one subscription to every browser that watches -----------
#
# A browser has no queue. It is given the newest message when it has taken the one before; events and distances of
# those that it missed are added, so that a slow browser loses pictures and nothing else.


# The pictures that a subscription may have.
KINDS = ("none", "plain", "drawn")

RETRY_S = 1.0
EVENTS_KEPT = 100
SAMPLES_KEPT_S = 300.0


class LiveMessage(Struct, frozen=True):
    """A snapshot as JSON, and its picture as JPEG."""

    snapshot: bytes
    picture: bytes = b""

    def encode(self) -> bytes:
        """Return it as the page's stream has it: both lengths, and both."""
        return struct.pack(">II", len(self.snapshot), len(self.picture)) + self.snapshot + self.picture


class History:
    """The events and distances of a run that a browser which comes now, or is slow, has not seen."""

    def __init__(self) -> None:
        self._begin(None)

    def _begin(self, run: Any) -> None:
        self._run = run
        self._last_event = -1
        self._events: deque[tuple[int, Any]] = deque(maxlen=EVENTS_KEPT)
        self._samples: dict[str, deque[tuple[int, Any]]] = {}

    def add(self, number: int, snapshot: Mapping[str, Any]) -> None:
        """Take what is new in the message of a number. After a restart of the run nothing of before remains."""
        run = (snapshot.get("run") or {}).get("started_unix_s")
        if run != self._run:
            self._begin(run)
        for event in snapshot.get("events", ()):
            if event["number"] > self._last_event:
                self._last_event = event["number"]
                self._events.append((number, event))
        for target, samples in snapshot.get("samples", {}).items():
            kept = self._samples.setdefault(target, deque())
            kept.extend((number, each) for each in samples if not kept or each[0] > kept[-1][1][0])
            while kept and kept[0][1][0] < kept[-1][1][0] - SAMPLES_KEPT_S:
                kept.popleft()

    def since(self, number: int) -> dict[str, Any]:
        """Return everything that came after the message of a number."""
        return {
            "events": [event for at, event in self._events if at > number],
            "samples": {
                target: [each for at, each in samples if at > number] for target, samples in self._samples.items()
            },
        }


class Feed:
    """The messages of one kind of picture. It is subscribed to while it has watchers.

    Args:
        explain: Says more of why there is no run.
    """

    def __init__(
        self, link: RunLink, image: str, explain: Callable[[PageError], PageError] = lambda error: error
    ) -> None:
        self._link = link
        self._explain = explain
        self._args = {"image": image}
        self._history = History()
        self._number = 0
        self._snapshot: Mapping[str, Any] | None = None
        self._newest = LiveMessage(b"")
        self._in_words: dict[int, bytes] = {}
        self._arrived = asyncio.Event()
        self._arrived_s = 0.0
        self._watchers = 0
        self._task: asyncio.Task[None] | None = None
        self._is_closed = False

    async def watch(self) -> AsyncGenerator[LiveMessage, None]:
        """Yield a message whenever there is a newer one. Ends when the page does."""
        self._watchers += 1
        if self._task is None:
            self._task = asyncio.create_task(self._follow())
        seen = 0
        try:
            while not self._is_closed:
                if self._snapshot is None or self._number == seen:
                    await self._arrived.wait()
                    continue
                message, seen = self._message(seen), self._number
                yield message
        finally:
            self._watchers -= 1
            if not self._watchers:
                self._rest()

    def close(self) -> None:
        """Let all who watch go."""
        self._is_closed = True
        self._rest()
        self._arrived.set()

    def _rest(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
        self._snapshot = None

    async def _follow(self) -> None:
        while True:
            try:
                async with aclosing(self._link.subscription(self._args)) as answers:
                    is_first = True
                    async for answer in answers:
                        self._take(answer, is_first=is_first)
                        is_first = False
            except PageError as error:
                why = self._explain(error)
                self._publish({"gone": str(why), "code": why.code}, b"")
            except (AttributeError, LookupError, TypeError):
                words = "the run says what this page does not understand: are they of one version?"
                self._publish({"gone": words, "code": "odd-run"}, b"")
            await asyncio.sleep(RETRY_S)

    def _take(self, answer: PageAnswer, *, is_first: bool) -> None:
        if not isinstance(answer.data, dict):
            raise TypeError("a snapshot is an object")
        self._history.add(self._number + 1, answer.data)
        self._publish(answer.data, answer.attached)
        if is_first:
            self._in_words.clear()  # what it brings may be known already

    def _publish(self, snapshot: Mapping[str, Any], picture: bytes) -> None:
        self._number += 1
        self._arrived_s = time.monotonic()
        self._snapshot = snapshot
        self._newest = LiveMessage(_json(snapshot), picture)
        self._in_words = {self._number - 1: self._newest.snapshot}
        arrived, self._arrived = self._arrived, asyncio.Event()
        arrived.set()

    def _message(self, seen: int) -> LiveMessage:
        """Return the newest message for one who has seen that of a number, and none of those between.

        A watcher who comes while the run hangs gets the last message, with its age.
        """
        snapshot = self._snapshot or {}
        if seen not in self._in_words:
            news = {} if "gone" in snapshot else self._history.since(seen)
            self._in_words[seen] = _json({**snapshot, **news})
        words = self._in_words[seen]
        if "gone" not in snapshot:
            words = b'{"waited_s":%.3f,' % (time.monotonic() - self._arrived_s) + words[1:]
        return LiveMessage(words, self._newest.picture)


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode("ascii")


# The answers of the page: files, logins, sessions, pictures and downloads -------------------------


# What the run says of itself that is for those alone who may operate.
HERE = Path(__file__).parent
NOT_FOR_WATCHERS = frozenset({"pid", "recordings"})

# What was asked for by one is given to others for this long: they cost the run nothing.
FRESH_S = 0.1

# Prometheus waits for 10 s, unless it is told otherwise: it must hear before that that the run does not answer.
METRICS_WAIT_S = 5.0
METRICS_MEDIA = "text/plain; version=0.0.4; charset=utf-8"

# The browser keeps a file and asks each time whether it has changed, so that none is older than the others.
REVALIDATED = {"Cache-Control": "no-cache"}

mimetypes.add_type("text/javascript", ".js")  # a system's own table may say otherwise, and then no module is loaded


class PageOptions(Struct, frozen=True, kw_only=True):
    """Options for serving the page.

    Attributes:
        configuration: The file that it is for; it need not be there yet.
        passwords: Where the passwords are.
        socket: Where the run listens; None to look for it.
        allowed_hosts: Names by which browsers may ask for us, besides our own.
        others: The pages of other cameras, whose alarms are shown with ours; None for none.
    """

    configuration: Path
    passwords: Path
    socket: Path | None = None
    allowed_hosts: tuple[str, ...] = ()
    others: Others | None = None


class Page:
    """The links, the feeds and who may what; and a method for each answer that is the process's own.

    Args:
        listens: The address and the port that it is served at.
    """

    def __init__(self, options: PageOptions, listens: tuple[str, int]) -> None:
        self.configuration = options.configuration.resolve()
        self.access = Access(PasswordFile(options.passwords), listens, options.allowed_hosts)
        self.run = RunLink(self.configuration, options.socket)
        self.workbench = WorkbenchLink(command_of_workbench(self.configuration, options.socket))
        self.run_process = RunProcess(self.run)
        self.feeds = {kind: Feed(self.run, kind, self.run_process.explain) for kind in KINDS}
        self._others = options.others
        self._static = StaticFiles(directory=HERE / "static", check_dir=False)
        self._answers: dict[tuple[str, ...], tuple[float, PageAnswer]] = {}
        self._asking: defaultdict[tuple[str, ...], asyncio.Lock] = defaultdict(asyncio.Lock)

    def end(self) -> None:
        """End all streams."""
        for feed in self.feeds.values():
            feed.close()

    async def close(self) -> None:
        """End what it started."""
        self.end()
        await asyncio.gather(self.workbench.close(), self.run_process.end())

    async def index(self, request: Request) -> Response:
        """The page itself."""
        return await self._file("index.html", request)

    async def static(self, request: Request) -> Response:
        """A file of the page."""
        return await self._file(request.path_params["file"], request)

    async def login_page(self, _request: Request) -> Response:
        """The form for the password."""
        return login_form()

    async def login_style(self, _request: Request) -> Response:
        """Return the style sheet of the form."""
        return FileResponse(HERE / "login.css", media_type="text/css", headers=REVALIDATED)

    async def login(self, request: Request) -> Response:
        """Begin a session, or say why not."""
        form = parse_qs((await bounded_body(request, 4096)).decode("utf-8", "replace"), keep_blank_values=True)
        address = request.client.host if request.client else ""
        try:
            passwords, right = await self.access.log_in(form.get("password", [""])[0], address)
        except PageError as error:
            return login_form(error)
        response = RedirectResponse("/", 303)
        self.access.begin_session(response, passwords, right, request.scope)
        return response

    async def logout(self, request: Request) -> Response:
        """End the session of this browser."""
        return self.access.end_session(request.scope)

    async def session(self, request: Request) -> Response:
        """Answer what the session may do, and what is there."""
        right: Right = request.scope["right"]
        may_operate = right is Right.OPERATE
        hidden = frozenset() if may_operate else NOT_FOR_WATCHERS
        return as_json(
            {
                "right": right.name.lower(),
                "needs_password": self.access.needs_password,
                "version": stadimeter.__version__,
                "configuration": str(self.configuration) if may_operate else self.configuration.name,
                "has_others": self._others is not None,
                "run": {name: value for name, value in (await self._about_run()).items() if name not in hidden},
            }
        )

    async def others(self, _request: Request) -> Response:
        """Answer what is known of other pages by now."""
        return as_json({"others": self._others.tell() if self._others else []})

    async def live(self, request: Request) -> Response:
        """Snapshots, for as long as the browser takes them."""
        messages = self._watched(request.query_params.get("image", "plain"), request)
        return Streamed(_frames(messages), "application/octet-stream")

    async def stream(self, request: Request) -> Response:
        """Pictures, each in the place of the one before, for anything that shows MJPEG."""
        return Streamed(_parts(self._watched(_image(request), request)), "multipart/x-mixed-replace; boundary=frame")

    async def snapshot(self, request: Request) -> Response:
        """Give the newest picture."""
        return as_picture(await self._ask_once("frame", encoding="jpeg", image=_image(request)), "image/jpeg")

    async def metrics(self, _request: Request) -> Response:
        """Give the figures of the run to Prometheus; without a run, that there is none."""
        if find_spec("prometheus_client") is None:
            raise PageError(503, "no-extra", "this needs the extra `metrics`: pip install 'stadimeter[metrics]'")
        from stadimeter.web.metrics import exposition  # noqa: PLC0415 - few pages are asked for them

        try:
            families = (await self._ask_once("metrics", METRICS_WAIT_S)).data
        except PageError as error:
            if error.status != 503:
                raise
            families = None
        return Response(exposition(families), media_type=METRICS_MEDIA)

    async def start(self, _request: Request) -> Response:
        """Start the run."""
        return as_json({"run": {"is_running": True, **await self.run_process.start()}})

    async def download(self, request: Request) -> Response:
        """Give a recording as a file."""
        name = request.path_params["name"]
        path = await self._recordings() / name
        is_plain = name == path.name and not name.startswith(".") and not path.is_symlink()
        if not (is_plain and await asyncio.to_thread(path.is_file)):
            raise PageError(404, "not-found", f"there is no recording {name!r}")
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    async def _ask_once(self, op: str, wait_s: float = RUN_WAIT_S, **args: str) -> PageAnswer:
        """Ask the run, or return what another was answered a moment ago."""
        asked = (op, *args.values())
        async with self._asking[asked]:
            answered_s, answer = self._answers.get(asked, (0.0, None))
            if answer is None or time.monotonic() - answered_s > FRESH_S:
                answer = await self.run.ask(op, args, wait_s)
                self._answers[asked] = (time.monotonic(), answer)
        return answer

    def _watched(self, image: str, request: Request) -> AsyncGenerator[LiveMessage, None]:
        """Return the messages of a feed, for as long as the session may read: a new password ends that."""
        if image not in self.feeds:
            raise PageError(400, "no-such-picture", f"image={image!r}: one of {', '.join(KINDS)} is wanted")
        feed = self.feeds[image]

        async def watched() -> AsyncGenerator[LiveMessage, None]:
            async with aclosing(feed.watch()) as messages:
                async for message in messages:
                    if not self.access.may_read(request.scope):
                        return
                    yield message

        return watched()

    async def _file(self, name: str, request: Request) -> Response:
        response = await self._static.get_response(name, request.scope)
        response.headers.update(REVALIDATED)
        return response

    async def _about_run(self) -> dict[str, Any]:
        try:
            told = await self.run_process.about()
        except PageError as error:
            words = str(self.run_process.explain(error))
            return {"is_running": False, "words": words, "may_start": self.run_process.may_start}
        return {"is_running": True, "words": "", "may_start": False, **told}

    async def _recordings(self) -> Path:
        """Return the folder of recordings, as the run says or, without one, the workbench."""
        folder = (await self._about_run()).get("recordings")
        return Path(folder or (await self.workbench.ask("recordings.recordings", {}, 60.0)).data["folder"])


def login_form(error: PageError | None = None) -> Response:
    """Return the form for the password, which works without JavaScript, and what was wrong."""
    words = "" if error is None or error.code == "not-logged-in" else f"{error}"
    text = (HERE / "login.html").read_text().replace("@MESSAGE@", html.escape(words[:1].upper() + words[1:]))
    headers = {"Retry-After": str(error.details["wait_s"])} if error and "wait_s" in error.details else {}
    return Response(text, error.status if error else 200, headers, "text/html")


def _image(request: Request) -> str:
    return "drawn" if request.query_params.get("drawn", "0") in {"1", "true"} else "plain"


async def _frames(messages: AsyncGenerator[LiveMessage, None]) -> AsyncGenerator[bytes, None]:
    async with aclosing(messages):
        async for message in messages:
            yield message.encode()


async def _parts(messages: AsyncGenerator[LiveMessage, None]) -> AsyncGenerator[bytes, None]:
    async with aclosing(messages):
        async for message in messages:
            if message.picture:
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(message.picture)}\r\n\r\n"
                yield head.encode() + message.picture + b"\r\n"
