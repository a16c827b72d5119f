"""Every path of the page, in one table: the right that it needs, who answers, and what its description says.

The description of the API (`docs/openapi.py`) is made from it. A path of the workbench names its function in
`stadimeter.workbench.server`, such as ``editing.check``; one of the page's process names a method of `web.page.Page`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Literal

from msgspec import Struct, field

from stadimeter.operator_actions import OperatorAction, Takes

# Of a request: a configuration with its camera file fits in.
BODY_MAX_BYTES = 4 * 1024 * 1024

# Time-outs of a cycle of the run, of a check of a configuration, of the workbench, and of a whole recording.
RUN_WAIT_S, CHECK_WAIT_S, WORKBENCH_WAIT_S, LONG_WAIT_S = 10.0, 60.0, 60.0, 300.0

Method = Literal["GET", "POST", "PUT", "DELETE"]


class Right(IntEnum):
    """The right that a path needs. Who may operate may read."""

    OPEN = 0
    READ = 1
    OPERATE = 2


class PageOperation(Struct, frozen=True, kw_only=True):
    """A path with a method.

    Attributes:
        path: Names in braces are handed on as arguments.
        to: Who answers: the run, the workbench, or this process itself.
        op: The operation that is asked for, or the name of this process's own method.
        summary: One line for the description of the API; empty for what it leaves out.
        answer: The table of ``docs/openapi.toml`` that describes the answer.
        query: The names of the query that are handed on, each with its kind, as in ``docs/openapi.toml``.
        body: The keys of the body with their kinds, or the name of a table; None where no body is described.
        wait_s: How long the answer may take.
        media: The kind of the answer's bytes; empty where the answer is JSON.
        names_operator: Whether the operation gets the operator's name, as ``by``.
        hidden: Keys of the answer for those alone who may operate.
        is_text: Whether it answers files of the page, which are sent compressed where a browser takes that.
    """

    method: Method
    path: str
    right: Right
    to: Literal["run", "workbench", "own"]
    op: str
    summary: str = ""
    answer: str = "Anything"
    query: Mapping[str, str] = field(default_factory=dict)
    body: str | Mapping[str, str] | None = None
    wait_s: float = RUN_WAIT_S
    media: str = ""
    names_operator: bool = False
    hidden: frozenset[str] = frozenset()
    is_text: bool = False

    @property
    def changes(self) -> bool:
        """True if it may change anything, so that it must come from a page of ours."""
        return self.method != "GET"


def _own(method: Method, path: str, right: Right, op: str, summary: str = "", **more: Any) -> PageOperation:
    how: dict[str, Any] = {"wait_s": CHECK_WAIT_S, **more}
    return PageOperation(method=method, path=path, right=right, to="own", op=op, summary=summary, **how)


def _read(path: str, op: str, summary: str, answer: str, **more: Any) -> PageOperation:
    return PageOperation(
        method="GET", path=f"/api/v1/{path}", right=Right.READ, to="run", op=op, summary=summary, answer=answer, **more
    )


def _run(path: str, op: str, summary: str, **more: Any) -> PageOperation:
    how: dict[str, Any] = {"right": Right.OPERATE, "to": "run", **more}
    return PageOperation(method="POST", path=f"/api/v1/{path}", op=op, summary=summary, **how)


def _set_up(step: str, op: str, summary: str) -> PageOperation:
    return _desk("POST", f"setup/{step}", op, summary, body="Anything")


def _desk(method: Method, path: str, op: str, summary: str, **more: Any) -> PageOperation:
    how: dict[str, Any] = {"right": Right.OPERATE, "wait_s": WORKBENCH_WAIT_S, **more}
    return PageOperation(method=method, path=f"/api/v1/{path}", to="workbench", op=op, summary=summary, **how)


_BODIES: Mapping[tuple[Takes, ...], str] = {
    (): "Action",
    ("for_s", "one_shot"): "TimedAction",
    ("key",): "ThresholdAction",
    ("key", "value"): "ThresholdValue",
}


def _action(action: OperatorAction) -> PageOperation:
    """Return the path of an operator action: of a rule, of all outputs, or of recordings."""
    path = f"rules/{{rule}}/{action.command}"
    if action.writes_file:
        path = f"recordings/{action.command}"
    elif action.is_on_outputs:
        path = f"outputs/{action.command.removesuffix('-outputs')}"
    body = _BODIES[action.takes]
    return _run(path, action.command, action.summary, body=body, names_operator=True)


# A program without a session may read these paths, each by a token of its own.
METRICS_PATH, ALARMS_PATH = "/metrics", "/api/v1/alarms"
TOKENS: Mapping[str, str] = {METRICS_PATH: "metrics", ALARMS_PATH: "alarms"}

_JPEG, _SVG = "image/jpeg", "image/svg+xml"
_DRAWN = {"drawn": "0|1"}

PAGE_OPERATIONS: tuple[PageOperation, ...] = (
    _own("GET", "/login", Right.OPEN, "login_page"),
    _own("GET", "/login.css", Right.OPEN, "login_style"),
    _own("POST", "/login", Right.OPEN, "login"),
    _own("POST", "/logout", Right.READ, "logout", "End the session of this browser"),
    _own("GET", "/", Right.READ, "index", is_text=True),
    _own("GET", "/static/{file:path}", Right.READ, "static", is_text=True),
    _own(
        "GET", "/snapshot.jpg", Right.READ, "snapshot", "The newest picture, with its values in X-Values",
        query=_DRAWN, media=_JPEG,
    ),
    _own(
        "GET", "/stream.mjpg", Right.READ, "stream", "Pictures as multipart MJPEG",
        query=_DRAWN, media="multipart/x-mixed-replace",
    ),
    _own("GET", METRICS_PATH, Right.READ, "metrics", "The figures of the run, for Prometheus", media="text/plain"),
    _own(
        "GET", "/api/v1/session", Right.READ, "session", "The right of this session, and whether the run is there",
        answer="Session",
    ),
    _own(
        "GET", "/api/v1/live", Right.READ, "live",
        "Snapshots with their pictures, until the reader hangs up. Repeated: length of the JSON and length of the JPEG "
        "(each 4 bytes, the highest first), a Snapshot or Gone as JSON, a JPEG",
        query={"image": "none|plain|drawn"}, media="application/octet-stream",
    ),
    _own(
        "GET", "/api/v1/others", Right.READ, "others",
        "The pages of other cameras: whether each answers, and its alarms", answer="Others",
    ),
    _read("status", "status", "The state of every rule, target and output", "Status"),
    _read("alarms", "alarms", "The alarms, newest first, and the newest 500 events", "Alarms"),
    _read(
        "rules/{rule}/explanation", "explain", "Why a rule acts, or does not: now, or some seconds ago", "Explanation",
        query={"ago_s": "number"},
    ),
    *(_action(action) for action in OperatorAction),
    _run(
        "outputs/{output}/hold", "hold-output",
        "Hold an output for 0.5 s, unless safety forbids it; repeat it to hold on",
        body={"level": "number", "linear_mps": "number", "angular_radps": "number", "release": "boolean", "by": "text"},
        names_operator=True,
    ),
    _own("POST", "/api/v1/run/start", Right.OPERATE, "start", "Start the run"),
    _run("run/restart", "restart", "Check the configuration, and start the run anew", wait_s=CHECK_WAIT_S),
    _run(
        "run/reload", "reload", "Apply the changed configuration, where no restart is needed", wait_s=CHECK_WAIT_S
    ),
    _run(
        "world", "world", "Move the target of a simulated world, or let something go wrong there",
        body={
            "target": "text", "x_m": "number", "y_m": "number", "bearing_rad": "number", "distance_m": "number",
            "fault": "text", "release": "boolean",
        },
    ),
    _desk(
        "GET", "timeline", "timeline.timeline", "Distances, states of rules, and events from one time to another",
        right=Right.READ, answer="Timeline", query={"from": "number", "to": "number", "points": "integer"},
    ),
    _desk(
        "GET", "timeline/marks", "timeline.marks", "The recordings of a time, and the thresholds of the rules",
        right=Right.READ, answer="TimelineMarks", query={"from": "number", "to": "number"},
    ),
    _desk(
        "GET", "timeline/moment", "timeline.moment", "What is known of a moment: why each rule acted, or not",
        right=Right.READ, answer="TimelineMoment", query={"at": "number"}, wait_s=LONG_WAIT_S,
    ),
    _desk(
        "POST", "rules/{rule}/tune", "tuning.tune",
        "What an alarm with other settings would have done, or with those that meet marks", answer="Tuned",
        body={"changes": "number{}", "marks": "text[]", "at_s": "number[]", "for_s": "number"}, wait_s=LONG_WAIT_S,
    ),
    _desk(
        "POST", "rules/{rule}/settings", "tuning.save", "Save other settings of an alarm, with a rule test",
        body={"changes": "number{}", "marks": "text[]", "at_s": "number[]", "base_version": "text"}, wait_s=LONG_WAIT_S,
    ),
    _desk(
        "GET", "recordings", "recordings.recordings", "The recordings", right=Right.READ, answer="Recordings",
        hidden=frozenset({"folder"}),
    ),
    _run("recordings", "record", "Begin or end a recording", body={"do": "start|stop"}),
    _own(
        "GET", "/api/v1/recordings/{name}", Right.OPERATE, "download", "A recording as a file",
        media="application/octet-stream",
    ),
    _desk(
        "GET", "recordings/{name}/frame.jpg", "recordings.recording_frame",
        "A moment of a recording, with its values in X-Values",
        query={"at_s": "number", "draw": "text"}, media=_JPEG,
    ),
    _desk("DELETE", "recordings/{name}", "recordings.delete", "Delete a recording"),
    _desk(
        "POST", "recordings/{name}/replay-diff", "replaying.replay_diff",
        "What a changed configuration would have done on a recording", body={"text": "text"}, wait_s=LONG_WAIT_S,
    ),
    _desk(
        "GET", "configuration", "editing.configuration", "The configuration and its former versions",
        answer="Configuration",
    ),
    _desk(
        "PUT", "configuration", "editing.save", "Save the configuration; 409 if another has changed it",
        body={"text": "text", "base_version": "text", "files": "text{}"},
    ),
    _desk(
        "POST", "configuration/check", "editing.check", "What is wrong with a text, and its rules in words",
        body={"text": "text"},
    ),
    _desk("GET", "configuration/versions/{id}", "editing.version", "A former version"),
    _desk(
        "POST", "configuration/versions/{id}/restore", "editing.restore", "Bring a former version back",
        body={"base_version": "text"},
    ),
    _desk(
        "GET", "targets/{target}/colour.jpg", "colours.picture",
        "What has a range of colours in the run's picture, with what it would give in X-Values",
        query={"range": "text", "width_px": "integer"}, media=_JPEG,
    ),
    _desk(
        "POST", "targets/{target}/colour", "colours.keep",
        "Save a range of colours; 409 if another has changed the file",
        body={"range": "text", "base_version": "text"},
    ),
    _desk("GET", "setup", "setup_operations.state", "Where the set-up stands", answer="Setup"),
    _set_up("answer", "setup_operations.answer", "Answer the question"),
    _set_up("back", "setup_operations.back", "Go back one question"),
    _set_up("begin", "setup_operations.begin", "Begin, or take up again"),
    _set_up("leave", "setup_operations.leave", "Close the camera and keep the answers"),
    _set_up("colour", "setup_operations.colour", "Fit the range of colours to clicks"),
    _set_up("camera", "setup_operations.camera", "Look at a camera that is offered, or set its exposure"),
    _set_up("world", "setup_operations.world", "Put the ball of the simulated room somewhere"),
    _set_up("files", "setup_operations.files", "What saving would write"),
    _desk(
        "GET", "setup/picture.jpg", "setup_operations.picture",
        "The newest picture of the set-up's camera, with its values in X-Values",
        query={"draw": "text", "width_px": "integer"}, media=_JPEG,
    ),
    _desk("GET", "certificate", "certifying.state", "The certificate of the site, and what was measured for it"),
    _desk("GET", "certificate.html", "certifying.page", "The certificate as a page to print", media="text/html"),
    _desk(
        "POST", "certificate/take", "certifying.take", "Measure at one distance by the tape",
        body={"distance": "text", "sigma": "text"}, wait_s=LONG_WAIT_S,
    ),
    _desk("POST", "certificate/finish", "certifying.finish", "Write the certificate"),
    _desk(
        "GET", "setup/wiring.svg", "setup_operations.wiring", "The wiring as a drawing, with its pins in X-Values",
        query={"output": "text"}, media=_SVG,
    ),
)  # fmt: skip
