"""The page as an application: every place of the table, who may go there, and what is handed on to whom."""

from __future__ import annotations

import json
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from stadimeter.errors import PageError
from stadimeter.web.access import Guard
from stadimeter.web.answers import as_error, as_json, as_picture, bounded_body
from stadimeter.web.page import Page, login_form
from stadimeter.web.routes import NAMED, PLACES, Place

_Endpoint = Callable[[Request], Awaitable[Response]]


def application(page: Page) -> ASGIApp:
    """Return the application: every place of the table, and 404 for all else."""
    routes = [_route(page, place) for place in PLACES]
    handlers: Mapping[Any, Any] = {PageError: _refused, HTTPException: _no_such, Exception: _defect}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), page.access, login_form)


def _route(page: Page, place: Place) -> Route:
    answer: _Endpoint = getattr(page, place.op) if place.to == "own" else _handed_on(page, place)

    async def admitted(request: Request) -> Response:
        page.access.check_place(place, request.scope)
        async with page.until_the_end():
            return await answer(request)

    route = Route(place.path, admitted)
    route.methods = {place.method}  # and no HEAD with each GET: a stream would not end
    return route


def _handed_on(page: Page, place: Place) -> _Endpoint:
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
    args = {**await _body(request, place), **_query(request, place), **request.path_params}
    if "ago_s" in args:
        args["at_unix_s"] = time.time() - args.pop("ago_s")
    if place.op in NAMED:
        args.setdefault("by", f"the page at {request.client.host}" if request.client else "the page")
    return args


def _query(request: Request, place: Place) -> dict[str, Any]:
    query = {}
    for name, kind in place.query.items():
        if name in request.query_params:
            try:
                query[name] = kind(request.query_params[name])
            except ValueError as error:
                raise PageError(400, "wrong-query", f"{name}: a number is wanted") from error
    return query


async def _body(request: Request, place: Place) -> Mapping[str, Any]:
    text = await bounded_body(request, place.body_max) if place.body_max else b""
    if not text:
        return {}
    try:
        found = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise PageError(400, "wrong-body", "the body of the request is no JSON") from error
    if not isinstance(found, dict):
        raise PageError(400, "wrong-body", "a JSON object is wanted")
    return found


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _refused(_request: Request, error: PageError) -> Response:
    return as_error(error)


def _no_such(request: Request, error: HTTPException) -> Response:
    code = {404: "not-found", 405: "wrong-method"}.get(error.status_code, "refused")
    return as_error(PageError(error.status_code, code, f"{request.method} {request.url.path}: {error.detail}"))


def _defect(_request: Request, error: Exception) -> Response:
    words = f"this is a defect of stadimeter, not of yours: {type(error).__name__}"
    return as_error(PageError(500, "defect", words))
