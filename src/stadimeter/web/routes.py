"""Every path of the page, in one table: what it needs, and who answers it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Literal

KIB, MIB = 1024, 1024 * 1024
RUN_WAIT_S, CHECK_WAIT_S, WORKBENCH_WAIT_S, LONG_WAIT_S = 10.0, 60.0, 60.0, 300.0
"""How long is waited for: a cycle of the run; a configuration that is checked; the workbench; a whole recording."""


class Right(IntEnum):
    """What a path needs. Who may operate may read."""

    OPEN = 0
    READ = 1
    OPERATE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A path with a method.

    Attributes:
        path: Names in braces are handed on as arguments.
        to: Who answers: the run, the workbench, or this process itself.
        op: The operation that is asked for, or the name of this process's own answer.
        query: The names of the query that are handed on, each with the type that it becomes.
        body_max: In bytes; 0 where no body is wanted. Its keys are handed on.
        wait_s: How long the answer may take.
        media: The kind of the bytes that are attached to the answer; empty where the answer is its data.
    """

    method: Literal["GET", "POST", "PUT", "DELETE"]
    path: str
    right: Right
    to: Literal["run", "workbench", "own"]
    op: str
    query: Mapping[str, type] = field(default_factory=dict)
    body_max: int = 0
    wait_s: float = RUN_WAIT_S
    media: str = ""

    @property
    def changes(self) -> bool:
        """Whether it may change anything, so that it must come from a page of ours."""
        return self.method != "GET"


def _own(method: Literal["GET", "POST", "DELETE"], path: str, right: Right, op: str, body_max: int = 0) -> Place:
    return Place(method=method, path=path, right=right, to="own", op=op, body_max=body_max, wait_s=CHECK_WAIT_S)


def _run(path: str, op: str, wait_s: float = RUN_WAIT_S) -> Place:
    return Place(method="POST", path=path, right=Right.OPERATE, to="run", op=op, body_max=64 * KIB, wait_s=wait_s)


def _asked(path: str, op: str, query: Mapping[str, type] | None = None) -> Place:
    return Place(method="GET", path=path, right=Right.READ, to="run", op=op, query=query or {})


def _set_up(step: str, wait_s: float = WORKBENCH_WAIT_S) -> Place:
    path, op = f"/api/v1/setup/{step}", f"setup-{step}"
    return Place(
        method="POST", path=path, right=Right.OPERATE, to="workbench", op=op, body_max=256 * KIB, wait_s=wait_s
    )


def _desk(method: Literal["GET", "POST", "PUT", "DELETE"], path: str, op: str, **more: Any) -> Place:
    how = {
        "right": Right.OPERATE,
        "body_max": 4 * MIB - 16 * KIB if method in {"POST", "PUT"} else 0,
        "wait_s": WORKBENCH_WAIT_S,
        **more,
    }
    return Place(method=method, path=f"/api/v1/{path}", to="workbench", op=op, **how)


_OF_RULES = ("ack", "reset", "shelve", "unshelve", "take-out", "put-back")
_OF_OUTPUTS = {"stop": "stop-outputs", "release": "release-outputs"}
NAMED = frozenset({*_OF_RULES, *_OF_OUTPUTS.values(), "hold-output"})
"""Operations that are told who wants them."""

_JPEG, _SVG = "image/jpeg", "image/svg+xml"

PLACES: tuple[Place, ...] = (
    _own("GET", "/login", Right.OPEN, "login_page"),
    _own("GET", "/login.css", Right.OPEN, "login_style"),
    _own("POST", "/login", Right.OPEN, "login", 4 * KIB),
    _own("POST", "/logout", Right.READ, "logout", 4 * KIB),
    _own("GET", "/", Right.READ, "index"),
    _own("GET", "/static/{file:path}", Right.READ, "static"),
    _own("GET", "/snapshot.jpg", Right.READ, "snapshot"),
    _own("GET", "/stream.mjpg", Right.READ, "stream"),
    _own("GET", "/api/v1/openapi.json", Right.READ, "openapi"),
    _own("GET", "/api/v1/session", Right.READ, "session"),
    _own("GET", "/api/v1/live", Right.READ, "live"),
    _asked("/api/v1/status", "status"),
    _asked("/api/v1/alarms", "alarms"),
    _asked("/api/v1/rules/{rule}/explanation", "explain", {"ago_s": float}),
    *(_run(f"/api/v1/rules/{{rule}}/{op}", op) for op in _OF_RULES),
    *(_run(f"/api/v1/outputs/{name}", op) for name, op in _OF_OUTPUTS.items()),
    _run("/api/v1/outputs/{output}/hold", "hold-output"),
    _own("POST", "/api/v1/run/start", Right.OPERATE, "start", 4 * KIB),
    _run("/api/v1/run/restart", "restart", CHECK_WAIT_S),
    _run("/api/v1/run/reload", "reload", CHECK_WAIT_S),
    _run("/api/v1/world", "world"),
    _desk("GET", "recordings", "recordings", right=Right.READ),
    _run("/api/v1/recordings", "record"),
    _own("GET", "/api/v1/recordings/{name}", Right.OPERATE, "download"),
    _desk("GET", "recordings/{name}/about", "recording", wait_s=LONG_WAIT_S),
    _desk("GET", "recordings/{name}/frame.jpg", "recording-frame", query={"at_s": float, "draw": str}, media=_JPEG),
    _desk("DELETE", "recordings/{name}", "recording-delete"),
    _desk("POST", "recordings/{name}/replay-diff", "replay-diff", wait_s=LONG_WAIT_S),
    _desk("GET", "configuration", "configuration"),
    _desk("PUT", "configuration", "save"),
    _desk("POST", "configuration/check", "check"),
    _desk("GET", "configuration/versions/{id}", "version"),
    _desk("POST", "configuration/versions/{id}/restore", "restore"),
    _desk("GET", "setup", "setup-state"),
    *(
        _set_up(step)
        for step in ("answer", "back", "begin", "leave", "colour", "camera", "world", "try", "files", "outlook")
    ),
    *(_set_up(step, LONG_WAIT_S) for step in ("take", "board")),
    _desk("GET", "setup/picture.jpg", "setup-picture", query={"draw": str, "width_px": int, "file": str}, media=_JPEG),
    _desk("GET", "setup/wiring.svg", "setup-wiring", query={"output": str}, media=_SVG),
)
