"""A run, its page, and a real Chromium that opens it: three processes as a user has them, ended with the test."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct

from stadimeter.app.control.client import ask
from stadimeter.errors import ControlError
from stadimeter.testing.rig import eventually
from support.programs import path_of, require
from support.simulated_run import LENS

PHONE, TABLET, DESKTOP = (360, 640), (768, 1024), (1440, 900)
"""The sizes that the page is made for, in CSS pixels."""

END_WAIT_S = 10.0
START_WAIT_S = 60.0
PAGE_WAIT_S = 60.0
"""How long an element is waited for: many times what it takes on a machine that others use too."""

ROOM = f"""
[camera]
driver = "simulated"
rate = "30 Hz"
{LENS}
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.motor]
driver = "simulated"

[actuators.buzzer]
driver = "simulated"

[base]
driver = "simulated"

[rules.far]
actuator = "motor"
ramp = {{ from = "2.5 m", to = "3.5 m" }}

[rules.near]
actuator = "buzzer"
when = {{ below = "1 m" }}
ack = "required"
latch = true

[world]
ball_diameter = "20 cm"
path = [
  {{ at = "0 s", x = "2 m", y = "0 m" }}, {{ at = "4 s", x = "0.8 m", y = "0 m" }},
  {{ at = "10 s", x = "3.2 m", y = "0.4 m" }}, {{ at = "16 s", x = "2 m", y = "0 m" }},
]
"""
"""A simulated room: a ball that comes near once, and goes far away; an output for each, and a base."""

STILL = ROOM.partition("path = [")[0] + 'path = [{ at = "0 s", x = "3.2 m", y = "0.3 m" }]\n'
"""The same room, and its ball does not move: 3.2 m away."""

SILENT_AFTER_ONE = """() => {
    const ask = window.fetch;
    let asked = 0;
    window.fetch = async (where, options) => {
        const response = await ask(where, options);
        if (!String(where).includes("/live?") || asked++) return response;
        const reader = response.body.getReader();
        const first = (await reader.read()).value;
        const body = new ReadableStream({
            start: (sink) => {
                sink.enqueue(first);
                options.signal.addEventListener("abort", () => sink.error(options.signal.reason));
            },
        });
        window.isSilent = true;
        return { ok: true, status: 200, body };
    };
}"""
"""The first stream ends as one does whose device lost its power: nothing comes any more, and nothing tells so."""


class Served(Struct):
    """A page and the run that it is of.

    Attributes:
        url: Where the page is, without a slash at its end.
        run: The process of the run; None if it was not wanted.
    """

    url: str
    configuration: Path
    page: subprocess.Popen[str]
    run: subprocess.Popen[str] | None
    environment: dict[str, str]

    def start_run(self) -> None:
        """Start the run as a user does in another terminal, and wait until it answers; the page finds it itself."""
        log = self.configuration.with_suffix(".run-log").open("w")
        command = [sys.executable, "-m", "stadimeter", "run", str(self.configuration)]
        with log:
            self.run = subprocess.Popen(command, env=self.environment, stdout=log, stderr=log, text=True)
        runtime = Path(self.environment["XDG_RUNTIME_DIR"])
        eventually(lambda: any(_answers(socket) for socket in runtime.rglob("*.sock")), START_WAIT_S)


@contextmanager
def served(folder: Path, text: str | None = ROOM, *options: str, runs: bool = True) -> Iterator[Served]:
    """Serve the page of a configuration on a free port.

    Args:
        text: The configuration; None leaves the file out, as for one who begins.
        options: Further options of ``stadimeter web``.
        runs: Whether the configuration is run as well.
    """
    configuration = folder / "stadimeter.toml"
    if text is not None:
        configuration.write_text(text)
    runtime = tempfile.mkdtemp(prefix="page-")  # short: the name of a socket has 107 bytes
    environment = {**os.environ, "XDG_RUNTIME_DIR": runtime, "XDG_STATE_HOME": str(folder)}
    environment.pop("INVOCATION_ID", None)
    command = [sys.executable, "-m", "stadimeter", "web", str(configuration), "--port", "0", *options]
    page = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, cwd=folder, text=True)
    here = Served("", configuration, page, None, environment)
    try:
        here.url = _address(page)
        if runs:
            here.start_run()
        yield here
    finally:
        for process in (page, here.run):
            _end(process)
        shutil.rmtree(runtime, ignore_errors=True)


def _answers(socket: Path) -> bool:
    try:
        return bool(ask(socket, "hello"))
    except ControlError:
        return False


def _address(page: subprocess.Popen[str]) -> str:
    assert page.stdout is not None
    for line in page.stdout:
        if "http" in line:
            return next(word for word in line.split() if word.startswith("http")).rstrip("/")
    raise AssertionError("the page ended before it served anything")


def _end(process: subprocess.Popen[str] | None) -> None:
    if process is None:
        return
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(END_WAIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdout is not None:
        process.stdout.close()


@contextmanager
def chromium() -> Iterator[Any]:
    """A real Chromium without a window; skips where there is none, or nothing to drive it."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser is driven")
    require("chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path_of("chromium"), args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def tab(browser: Any, *, size: tuple[int, int] = DESKTOP, scheme: str = "light", **options: Any) -> Iterator[Any]:
    """A tab with nothing stored in it. A script that fails, or that the security policy stops, fails the test."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, has_touch=size == PHONE, **options
    )
    context.set_default_timeout(PAGE_WAIT_S * 1000)
    page = context.new_page()
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on(
        "console",
        lambda said: faults.append(said.text) if said.type == "error" and "Failed to load" not in said.text else None,
    )
    try:
        yield page
    finally:
        context.close()
    assert not faults, faults


def until(page: Any, condition: str, what: str = "", wait_s: float = PAGE_WAIT_S) -> Any:
    """Wait until an expression of the page is true, and return it.

    Playwright's own way evaluates a text within the page, which the page's security policy forbids.
    """
    deadline_s = time.monotonic() + wait_s
    while not (found := page.evaluate(condition)):
        assert time.monotonic() < deadline_s, what or condition
        page.wait_for_timeout(50)
    return found
