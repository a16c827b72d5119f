"""The page, served by a thread on a free port, requests as a browser sends them, and what is wrong with its looks."""

from __future__ import annotations

import asyncio
import http.client
import json
import queue
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec import Struct, field

from stadimeter.web import access, passwords
from stadimeter.web.page import Page, PageOptions
from stadimeter.web.passwords import PasswordFile
from stadimeter.web.serving import listen, server_of

# The page, served by a thread of the test on a free port, and requests to it as a browser sends them.

QUICK_SCRYPT = {"n": 2**4, "r": 8, "p": 1}
OPERATE, READ = "correct horse", "battery staple"
JSON = {"Content-Type": "application/json"}
FORM = {"Content-Type": "application/x-www-form-urlencoded"}


class Answer(Struct):
    """What a browser is answered."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def data(self) -> Any:
        """The body as JSON."""
        return json.loads(self.body)

    @property
    def error(self) -> str:
        """The code of the error that it is."""
        return self.data["error"]["code"]


class ServedPage(Struct):
    """A page that is served, and a browser of it, which keeps its cookies."""

    page: Page
    port: int
    cookies: dict[str, str] = field(default_factory=dict)

    def ask(self, method: str, path: str, body: Any = None, headers: Mapping[str, str] | None = None) -> Answer:
        """Send a request, as a page of ours does, but for headers that are given; one that is empty is left out."""
        origin = {} if method == "GET" else {"Origin": f"http://127.0.0.1:{self.port}", **JSON}
        cookie = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        sent = {name: value for name, value in ({"Cookie": cookie} | origin | dict(headers or {})).items() if value}
        data = body if isinstance(body, bytes | str | None) else json.dumps(body)
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.request(method, path, data, sent)
            response = connection.getresponse()
            return Answer(response.status, response.headers, response.read())
        finally:
            connection.close()

    def get(self, path: str, **headers: str) -> Answer:
        """Send a request that changes nothing."""
        return self.ask("GET", path, headers=headers)

    def log_in(self, password: str) -> Answer:
        """Send the form of the login page, and keep the cookie."""
        answer = self.ask("POST", "/login", f"password={password.replace(' ', '+')}", FORM)
        for cookie in answer.headers.get_all("set-cookie") or ():
            name, _, value = cookie.partition(";")[0].partition("=")
            self.cookies[name] = value
        return answer


@contextmanager
def served_page(
    folder: Path, *words: str, socket: Path | None = None, hosts: tuple[str, ...] = ()
) -> Iterator[ServedPage]:
    """Serve a page.

    Args:
        words: The password for operating, and that for watching.
        socket: Of the run that it is of; by default there is none.
    """
    file = folder / "page.passwords"
    for right, word in zip(("operate", "read"), words, strict=False):
        PasswordFile(file).set(right, word)
    options = PageOptions(
        configuration=folder / "page.toml", passwords=file, socket=socket or folder / "no-run.sock", allowed_hosts=hosts
    )
    listener = listen("127.0.0.1", 0, file)
    page = Page(options, listener.getsockname()[:2])
    server = server_of(page)

    loops: queue.SimpleQueue[asyncio.AbstractEventLoop] = queue.SimpleQueue()

    async def serve() -> None:
        loops.put(asyncio.get_running_loop())
        await server.serve(sockets=[listener])
        await page.close()

    thread = threading.Thread(target=asyncio.run, args=(serve(),))
    thread.start()
    loop = loops.get()  # a test that asks nothing may end before the thread has begun
    try:
        yield ServedPage(page, listener.getsockname()[1])
    finally:
        server.should_exit = True
        loop.call_soon_threadsafe(page.end)
        thread.join()


def quicken(monkeypatch: Any) -> None:
    """Let passwords be hashed at once, and let no one wait after a wrong one."""
    monkeypatch.setattr(passwords, "SCRYPT", QUICK_SCRYPT)
    monkeypatch.setattr(access, "AFTER_WRONG_S", 0.0)


# What is wrong with a page as a browser draws it: cut off, too faint, without a name, out of reach of the keyboard.

SCRIPT = Path(__file__).with_name("page_checks.js").read_text(encoding="utf-8")
TABS_MAX = 400


def faults_of(page: Any) -> list[str]:
    """Return what is cut off, what has too little contrast, what has no name, and what is too small to touch."""
    page.evaluate(SCRIPT)
    return page.evaluate("window.pageChecks.all()")


def out_of_reach(page: Any) -> list[str]:
    """Press Tab until the focus has been everywhere; return what it did not come to, or where it was not to be seen."""
    page.evaluate(SCRIPT)
    page.evaluate("document.activeElement?.blur()")
    for _ in range(TABS_MAX):
        page.keyboard.press("Tab")
        if page.evaluate("window.pageChecks.visit()"):
            break
    return page.evaluate("window.pageChecks.unreachable()")
