"""The page as an application: every path of the table, who may go there, and what is handed on to whom."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from stadimeter.errors import PageError
from stadimeter.web.access import AccessGuard
from stadimeter.web.answers import as_error, as_json, as_picture, bounded_body
from stadimeter.web.page import Page, login_form
from stadimeter.web.routes import PAGE_OPERATIONS, PageOperation

_READ_AS: Mapping[str, type] = {"number": float, "integer": int}
_Endpoint = Callable[[Request], Awaitable[Response]]


def application(page: Page) -> ASGIApp:
    """Return the application: every path of the table, and 404 for all else."""
    routes = [_route(page, operation) for operation in PAGE_OPERATIONS]
    handlers: Mapping[Any, Any] = {PageError: _answer_refusal, HTTPException: _no_such, Exception: _defect}
    return AccessGuard(Starlette(routes=routes, exception_handlers=handlers), page.access, login_form)


def _route(page: Page, operation: PageOperation) -> Route:
    answer: _Endpoint = getattr(page, operation.op) if operation.to == "own" else _handed_on(page, operation)

    async def admitted(request: Request) -> Response:
        page.access.check(operation, request.scope)
        async with page.until_the_end():
            return await answer(request)

    route = Route(operation.path, admitted)
    route.methods = {operation.method}  # and no HEAD with each GET: a stream would not end
    return route


def _handed_on(page: Page, operation: PageOperation) -> _Endpoint:
    async def ask(request: Request) -> Response:
        args = await _args(request, operation)
        if operation.to == "run":
            answer = await page.run.ask(operation.op, args, operation.wait_s)
        else:
            answer = await page.workbench.ask(operation.op, args, operation.wait_s)
        return as_picture(answer, operation.media) if operation.media else as_json(answer.data)

    return ask


async def _args(request: Request, operation: PageOperation) -> dict[str, Any]:
    """Return the arguments that are handed on: of the body, of the query, and of the path, which has the last word."""
    args = {**await _body(request, operation), **_query(request, operation), **request.path_params}
    if "ago_s" in args:
        args["at_unix_s"] = time.time() - args.pop("ago_s")
    if operation.names_operator:
        args.setdefault("by", f"the page at {request.client.host}" if request.client else "the page")
    return args


def _query(request: Request, operation: PageOperation) -> dict[str, Any]:
    query = {}
    for name, kind in operation.query.items():
        if name in request.query_params:
            try:
                query[name] = _READ_AS.get(kind, str)(request.query_params[name])
            except ValueError as error:
                raise PageError(400, "wrong-query", f"{name}: a number is wanted") from error
    return query


async def _body(request: Request, operation: PageOperation) -> Mapping[str, Any]:
    text = await bounded_body(request, operation.body_max) if operation.body_max else b""
    if not text:
        return {}
    try:
        return msgspec.json.decode(text, type=dict[str, Any])
    except (ValueError, RecursionError) as error:
        raise PageError(400, "wrong-body", f"the body of the request is no JSON object: {error}") from error


def _answer_refusal(_request: Request, error: PageError) -> Response:
    return as_error(error)


def _no_such(request: Request, error: HTTPException) -> Response:
    code = {404: "not-found", 405: "wrong-method"}.get(error.status_code, "refused")
    return as_error(PageError(error.status_code, code, f"{request.method} {request.url.path}: {error.detail}"))


def _defect(_request: Request, error: Exception) -> Response:
    words = f"this is a defect of stadimeter, not of yours: {type(error).__name__}"
    return as_error(PageError(500, "defect", words))
