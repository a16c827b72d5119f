"""Answers as HTTP has them: data, pictures with their values, errors, and streams."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Any
from urllib.parse import quote

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from stadimeter.errors import PageError
from stadimeter.web.links import PageAnswer

# A body that takes longer to come is not waited for.
BODY_MAX_S = 30.0

# The header of a picture that holds what it shows, as JSON with percent signs for what no header may have.
VALUES = "X-Values"


def as_json(data: Any, status: int = 200) -> Response:
    """Return data."""
    return Response(json.dumps(data, separators=(",", ":")), status, media_type="application/json")


def as_picture(answer: PageAnswer, media: str) -> Response:
    """Return the attachment of an answer, and its data in a header."""
    values = quote(json.dumps(answer.data, separators=(",", ":")), safe="")
    return Response(answer.attached, media_type=media, headers={VALUES: values})


def as_error(error: PageError) -> Response:
    """Return why something is not done."""
    told = {"code": error.code, "message": str(error), "problems": [], **error.details}
    answer = as_json({"error": told}, error.status)
    if "wait_s" in error.details:
        answer.headers["Retry-After"] = str(error.details["wait_s"])
    return answer


async def bounded_body(request: Request, most_bytes: int) -> bytes:
    """Return the body of a request; `PageError` if it is too large, or does not come."""
    parts, size = [], 0
    try:
        async with asyncio.timeout(BODY_MAX_S):
            async for part in request.stream():
                parts.append(part)
                size += len(part)
                if size > most_bytes:
                    raise PageError(413, "too-large", f"more than {most_bytes} bytes are not taken here")
    except TimeoutError as error:
        raise PageError(408, "too-slow", f"the request did not come within {BODY_MAX_S:g} s") from error
    except ClientDisconnect as error:
        raise PageError(400, "gone", "the browser hung up") from error
    return b"".join(parts)


class Streamed(StreamingResponse):
    """Sends parts until they end, or the browser is gone. Waits until the browser has taken each."""

    def __init__(self, parts: AsyncGenerator[bytes, None], media: str) -> None:
        super().__init__(parts, media_type=media)
        self._parts = parts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request. What the parts hold is let go of at once, however it ends."""
        async with aclosing(self._parts):
            await super().__call__(scope, receive, send)
