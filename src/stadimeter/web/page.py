"""The page as an application: every path of the table, and the answers that this process gives itself."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

import stadimeter
from stadimeter.errors import PageError
from stadimeter.web.answers import Streamed, as_error, as_json, as_picture
from stadimeter.web.live import Feeds, Message
from stadimeter.web.routes import PLACES, Place
from stadimeter.web.run_link import RunLink
from stadimeter.web.workbench_link import WorkbenchLink

HERE = Path(__file__).parent
STATIC = HERE / "static"

Endpoint = Callable[[Request], Awaitable[Response]]


class Page:
    """What all answers share: the links, the feeds, and who may what."""

    def __init__(self, configuration: Path, run: RunLink, workbench: WorkbenchLink) -> None:
        self.configuration = configuration
        self.run = run
        self.workbench = workbench
        self.feeds = Feeds(run)
        self._static = StaticFiles(directory=STATIC, check_dir=False)

    async def index(self, request: Request) -> Response:
        """The page itself."""
        return await self._static.get_response("index.html", request.scope)

    async def static(self, request: Request) -> Response:
        """A file of the page."""
        return await self._static.get_response(request.path_params["file"], request.scope)

    async def session(self, _request: Request) -> Response:
        """Who asks may what, and what is there."""
        return as_json(
            {
                "right": "operate",
                "needs_password": False,
                "version": stadimeter.__version__,
                "configuration": str(self.configuration),
                "run": await self._about_run(),
            }
        )

    async def live(self, request: Request) -> Response:
        """Snapshots, for as long as the browser takes them."""
        feed = self.feeds[request.query_params.get("image", "plain")]
        return Streamed(_framed(feed.watch()), "application/octet-stream")

    async def _about_run(self) -> dict[str, Any]:
        try:
            told = (await self.run.ask("hello")).data
        except PageError as error:
            return {"is_running": False, "words": str(error)}
        return {"is_running": True, "words": "", **told}


async def _framed(messages: AsyncGenerator[Message, None]) -> AsyncGenerator[bytes, None]:
    async for message in messages:
        yield message.framed()


def application(page: Page) -> Starlette:
    """Return the application: every place of the table, and 404 for all else."""
    routes = [Route(place.path, _endpoint(page, place), methods=[place.method]) for place in PLACES]
    return Starlette(routes=routes, exception_handlers={PageError: _refused, HTTPException: _no_such})


def _endpoint(page: Page, place: Place) -> Endpoint:
    if place.to == "own":
        own: Endpoint = getattr(page, place.op, _not_yet)
        return own

    async def ask(request: Request) -> Response:
        args = await _args(request, place)
        if place.to == "run":
            answer = await page.run.ask(place.op, args, place.wait_s)
        else:
            answer = await page.workbench.ask(place.op, args, place.wait_s)
        return as_picture(answer, place.media) if place.media else as_json(answer.data)

    return ask


async def _args(request: Request, place: Place) -> dict[str, Any]:
    """Return what is handed on: of the body, of the query, and of the path, which has the last word."""
    query = {}
    for name, kind in place.query.items():
        if name in request.query_params:
            try:
                query[name] = kind(request.query_params[name])
            except ValueError as error:
                raise PageError(400, "wrong-query", f"{name}: a number is wanted") from error
    args = {**await _body(request, place), **query, **request.path_params}
    if "ago_s" in args:
        args["at_unix_s"] = time.time() - args.pop("ago_s")
    return args


async def _body(request: Request, place: Place) -> Mapping[str, Any]:
    text = await request.body() if place.body_max else b""
    if not text:
        return {}
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PageError(400, "wrong-body", "the body of the request is no JSON") from error
    if not isinstance(found, dict):
        raise PageError(400, "wrong-body", "a JSON object is wanted")
    return found


async def _not_yet(request: Request) -> Response:
    raise PageError(404, "not-found", f"{request.url.path}: not yet")


def _refused(_request: Request, error: Exception) -> Response:
    assert isinstance(error, PageError)  # noqa: S101
    return as_error(error)


def _no_such(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101
    return as_error(PageError(error.status_code, "not-found", error.detail))
