"""The recordings of a run, for the page: which there are, any moment of them drawn, and to be rid of one."""

from __future__ import annotations

import fcntl
import json
import os
import stat
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from msgspec.structs import replace

from stadimeter.app.control.recording import CLIPS, LAST
from stadimeter.app.live.history import Seen
from stadimeter.app.live.pictures import Pictures
from stadimeter.app.live.snapshot import RunSnapshot, shared_data
from stadimeter.app.recordings.journal import ENDING, JournalHeader, load_recorded
from stadimeter.config.files import open_untrusted
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, JournalError, NotThereError, StadimeterError
from stadimeter.workbench.replay import RecordedMoment, RecordingIndex, read_index
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.run_of_desk import folder_of

# The newest of them; a folder that nobody tidies up has thousands.
LISTED_MAX = 500


@operation
def recordings(desk: Desk) -> dict[str, Any]:
    """Answer the recordings and clips that there are, newest first."""
    folder = folder_of(desk)
    newest = [path for path in recordings_of(desk).values() if path.parent in {folder, folder / CLIPS}]
    listed = []
    for path in newest[:LISTED_MAX]:
        with suppress(FileNotFoundError):  # deleted since, or removed by a run that recorded nothing
            listed.append(about(desk, path))
    return {"folder": str(folder), "recordings": listed, "left_out": max(0, len(newest) - LISTED_MAX)}


def recordings_of(desk: Desk) -> dict[str, Path]:
    """Return every recording of the run by its name below the folder, newest first: its own, clips, the last hour."""
    folder = folder_of(desk)
    inside = (folder, folder / CLIPS, folder / LAST / desk.configuration.stem)
    paths = (path for each in inside for path in each.glob(f"*{ENDING}"))
    ended_s = {path: about_file.st_mtime for path in paths if (about_file := _file(path))}
    newest = sorted(ended_s, key=ended_s.__getitem__, reverse=True)
    return {path.relative_to(folder).as_posix(): path for path in newest}


@operation
def delete(desk: Desk, name: str) -> dict[str, Any]:
    """Delete a recording, unless it is being written."""
    path = path_of(desk, name)
    with open_untrusted(path) as file:
        if _is_being_written(file):
            raise JournalError(f"{path.name} is being recorded; stop that first")
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise JournalError(f"{path.name} cannot be deleted: {(error.strerror or str(error)).lower()}") from error
    desk.kept.pop("recording", None)
    return {"name": path.name}


def path_of(desk: Desk, name: str) -> Path:
    """Return where the recording or clip is that is meant; never another file than one of these folders.

    Raises:
        NotThereError: There is none of that name.
    """
    folder = folder_of(desk)
    if name == Path(name).name and name.endswith(ENDING):
        for path in (folder / name, folder / CLIPS / name):
            if _file(path):
                return path
    raise NotThereError(f"there is no recording {name!r} in {folder}")


def index_of(desk: Desk, path: Path) -> RecordingIndex:
    """Return the index of a recording; that of the one that was asked for last is kept."""
    return desk.remember("recording", _key(path), lambda: read_index(path))


def _file(path: Path) -> os.stat_result | None:
    """Return the status that the system gives of a file; None for none, or a link, which could lead anywhere."""
    try:
        found = path.lstat()
    except (OSError, ValueError):
        return None
    return found if stat.S_ISREG(found.st_mode) else None


def _key(path: Path) -> tuple[str, int, int]:
    found = path.stat()
    return str(path), found.st_size, found.st_mtime_ns


def about(desk: Desk, path: Path) -> dict[str, Any]:
    """Describe a recording for the list. It is looked into once, unless it grows."""
    known: dict[Any, dict[str, Any]] = desk.kept.setdefault("recordings", {})
    key = _key(path)
    if key not in known or known[key]["is_growing"]:
        known[key] = _look_into(path)
        while len(known) > LISTED_MAX:
            del known[next(iter(known))]
    return known[key]


def _look_into(path: Path) -> dict[str, Any]:
    file_about = path.stat()
    told: dict[str, Any] = {
        "name": path.name,
        "bytes": file_about.st_size,
        "unix_s": file_about.st_mtime,
        "seconds": None,
        "began_unix_s": None,
        "ended_unix_s": None,
        "clip_of": None,
        "configuration": "",
        "damage": "",
        "is_growing": False,
    }
    try:
        with open_untrusted(path) as file:
            told["is_growing"] = _is_being_written(file)
        index = read_index(path)
        found, began_s = index.recording, began_unix_s(index.recording.header, file_about.st_mtime)
        told |= {"unix_s": began_s, "began_unix_s": began_s, "ended_unix_s": began_s + index.seconds}
        told |= {"seconds": index.seconds, "clip_of": found.clip_of, "configuration": _in_words(found.header)}
        if not told["is_growing"] and found.is_cut_off():
            told["damage"] = "its end is missing, as after a power cut; what comes before can be used"
    except StadimeterError as error:
        if not told["is_growing"]:  # one that has only just begun lacks its first cycle
            told["damage"] = str(error)
    return told


def began_unix_s(header: JournalHeader, otherwise_s: float) -> float:
    """Return when a recording began, in seconds since 1970."""
    try:
        return datetime.fromisoformat(header.began_at).timestamp()
    except ValueError:
        return otherwise_s


def _in_words(header: JournalHeader) -> str:
    """Say which rules a recording was made with."""
    try:
        rules = list(tomllib.loads(header.configuration).get("rules", {}))
    except (tomllib.TOMLDecodeError, AttributeError):
        return ""
    return f"rules {', '.join(rules)}" if rules else "no rules"


def _is_being_written(file: BinaryIO) -> bool:
    """Check whether a run writes to it, which keeps it locked."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


# The messages have (0, 0) at the corner of the first pixel, not at its centre.
QUALITY = 80
FIRST_PIXEL = 0.5

# The parts of a live snapshot that a recording has, too.
SHOWN = ("frame", "targets", "rules", "outputs", "safety")


@operation
def recording_frame(desk: Desk, name: str, at_s: float = 0.0, draw: str = "drawn") -> DeskReply:
    """Answer the picture of a moment of a recording, as JPEG, and what was known and decided then.

    ``at_s`` is since its beginning; ``draw`` is ``plain`` to draw nothing.
    """
    path = path_of(desk, name)
    index = index_of(desk, path)
    moment = index.moment(at_s)
    seen = None
    if moment.seen is not None:
        detections = tuple(_detections(moment.annotations))
        seen = Seen(replace(moment.seen.record(), detections=detections), moment.frame)
    jpeg = Pictures().jpeg(seen, "plain" if draw == "plain" else "drawn", QUALITY) if seen else b""
    return DeskReply(data=_values(desk, index, moment, seen), attached=jpeg)


def _values(desk: Desk, index: RecordingIndex, moment: RecordedMoment, seen: Seen | None) -> dict[str, Any]:
    """Return the values to see then, by the names of a live snapshot; outlines are in the picture already."""
    record = moment.cycle.record()
    now_s = record.observation.now_s
    unix_s = began_unix_s(index.recording.header, 0.0) + moment.at_s
    plan = _plan(desk, index)
    snapshot = RunSnapshot(record=record, seen=seen, started_s=now_s - moment.at_s, plan=plan)
    told = shared_data(snapshot, 0, now_s, unix_s - now_s)
    for target in told["targets"]:
        target["detection"], target["rejected"] = None, []
    return {"at_s": moment.at_s, "unix_s": unix_s, "seconds": index.seconds, **{key: told[key] for key in SHOWN}}


def _plan(desk: Desk, index: RecordingIndex) -> Plan | None:
    """Return the plan that the recording's configuration declares; None for one that this version cannot read."""
    recorded = index.recording.header.recorded_configuration

    def load() -> Plan | None:
        with suppress(ConfigError):
            return load_recorded(recorded, index.recording.path).plan
        return None

    return desk.remember("recorded plan", recorded, load)


def _detections(annotations: bytes) -> Iterator[Detection]:
    """Yield what the annotations of a picture outline."""
    try:
        for line in json.loads(annotations or b"{}").get("points", []):
            corners = np.array([[point["x"], point["y"]] for point in line["points"]], float).reshape(-1, 2)
            outline_px, target = corners - FIRST_PIXEL, line["metadata"][0]["value"]
            x, y = (outline_px.min(axis=0) + outline_px.max(axis=0)) / 2
            centre_px = float(x), float(y)
            yield Detection(target=target, status=DetectionStatus.FOUND, centre_px=centre_px, outline_px=outline_px)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):  # damaged, or of another program
        return
