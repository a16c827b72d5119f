"""A moment of a recording as the page shows it: its picture with what was measured drawn in, and its values."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.history import Seen
from stadimeter.app.live.pictures import Pictures
from stadimeter.app.live.snapshot import RunSnapshot
from stadimeter.app.live.snapshot_json import ReasonsInTurn, shared_json
from stadimeter.app.recordings.journal import load_recorded
from stadimeter.core.detection import Detection, DetectionStatus, Points
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, JournalError
from stadimeter.workbench.replay.recording_index import RecordedMoment, RecordingIndex
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.recordings import began_unix_s, index_of, path_of

# The messages have (0, 0) at the corner of the first pixel, not at its centre.
QUALITY = 80
RIM_POINTS = 48
FIRST_PIXEL = 0.5

# The parts of a live snapshot that a recording has, too.
SHOWN = ("frame", "targets", "rules", "outputs", "safety")


@operation
def recording_frame(desk: Desk, name: str, at_s: float = 0.0, draw: str = "drawn") -> DeskReply:
    """Answer the picture of a moment of a recording, as JPEG, and what was known and decided then.

    ``at_s`` is since its beginning; ``draw`` is ``plain`` to draw nothing.
    """
    path = path_of(desk, name)
    if path.suffix != ".mcap":
        raise JournalError(f"{path.name} is a journal, and has no pictures; its decisions can be replayed")
    index = index_of(desk, path)
    moment = index.moment(at_s)
    seen = None if moment.seen is None else Seen(_with_detections(moment), moment.frame)
    jpeg = Pictures().jpeg(seen, "plain" if draw == "plain" else "drawn", QUALITY) if seen else b""
    return DeskReply(data=_values(desk, index, moment, seen), attached=jpeg)


def _values(desk: Desk, index: RecordingIndex, moment: RecordedMoment, seen: Seen | None) -> dict[str, Any]:
    """Return the values to see then, by the names of a live snapshot; outlines are in the picture already."""
    record = moment.cycle.record()
    now_s = record.observation.now_s
    unix_s = began_unix_s(index.recording.header, 0.0) + moment.at_s
    plan = _plan(desk, index)
    snapshot = RunSnapshot(record=record, seen=seen, started_s=now_s - moment.at_s, plan=plan)
    told = json.loads(shared_json(snapshot, 0, now_s, unix_s - now_s, ReasonsInTurn()) + "}")
    for target in told["targets"]:
        target["detection"], target["rejected"] = None, []
    return {"at_s": moment.at_s, "unix_s": unix_s, "seconds": index.seconds, **{key: told[key] for key in SHOWN}}


def _plan(desk: Desk, index: RecordingIndex) -> Plan | None:
    """Return the plan that the recording's configuration declares; None for one that this version cannot read."""
    recording = index.recording
    if desk.kept.get("recorded plan", (None, None))[0] is not index:
        try:
            plan = load_recorded(recording.header.recorded_configuration, recording.path).plan
        except ConfigError:
            plan = None
        desk.kept["recorded plan"] = index, plan
    found: Plan | None = desk.kept["recorded plan"][1]
    return found


def _with_detections(moment: RecordedMoment) -> CycleRecord:
    """Return the cycle of a picture with where its targets are in it, which stands in the recording's annotations."""
    if moment.seen is None:
        raise JournalError("there is no picture")
    return replace(moment.seen.record(), detections=tuple(_detections(moment)))


def _detections(moment: RecordedMoment) -> Iterator[Detection]:
    """Yield the outlines; of recordings that have none, the circles around what was measured."""
    try:
        found = json.loads(moment.annotations or b"{}")
        for line in found.get("points", []):
            outline = np.array([[point["x"], point["y"]] for point in line["points"]], float).reshape(-1, 2)
            yield _detection_of(line["metadata"][0]["value"], outline - FIRST_PIXEL)
        for number, circle in enumerate(found.get("circles", [])):
            if circle["outline_color"]["r"] < circle["outline_color"]["g"]:  # not red, which is what was rejected
                centre = circle["position"]["x"] - FIRST_PIXEL, circle["position"]["y"] - FIRST_PIXEL
                named = circle["metadata"]
                target = named[0]["value"] if named else found["texts"][number]["text"].rsplit(" ", 2)[0]
                yield _detection_of(target, _rim(centre, float(circle["diameter"])))
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):  # damaged, or of another program
        return


def _rim(centre_px: tuple[float, float], across_px: float) -> Points:
    angles = np.linspace(0, 2 * math.pi, RIM_POINTS, endpoint=False)
    rim: Points = np.array(centre_px) + across_px / 2 * np.column_stack([np.cos(angles), np.sin(angles)])
    return rim


def _detection_of(target: str, outline_px: Points) -> Detection:
    x, y = (outline_px.min(axis=0) + outline_px.max(axis=0)) / 2
    centre = float(x), float(y)
    return Detection(target=target, status=DetectionStatus.FOUND, centre_px=centre, outline_px=outline_px)
