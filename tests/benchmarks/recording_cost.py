"""What recording costs: in the loop, in the thread beside it, and on the disk.

Run ``python tests/benchmarks/recording_cost.py``.

A run of the demonstration is kept in memory, with its pictures of 640 x 480, and then recorded in several ways. In the
loop there is only the handing over of a cycle; encoding, compressing and writing is done by a thread of the recorder,
and most of it in libraries that let the loop go on meanwhile. A journal is written by such a thread, too.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from time import thread_time

from msgspec import Struct

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter
from stadimeter.app.recordings.recorded_configuration import to_be_recorded
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter
from stadimeter.core.frame import Frame

FRAMES = 600
OPTIONS = {
    "recording without pictures": ImageOptions(images="none"),
    "recording, 5 pictures a second": ImageOptions(rate_hz=5),
    "recording, every picture": ImageOptions(),
    "recording, every picture, quality 95": ImageOptions(quality_percent=95),
}

Kept = list[tuple[CycleRecord, Frame | None]]


class Row(Struct, frozen=True, kw_only=True):
    """One line of the report: the median and the mean cost of a cycle in microseconds, and its bytes."""

    what: str
    median_us: float
    mean_us: float
    cycle_bytes: float


def kept_run(frames: int) -> tuple[Kept, Recorded]:
    """Run the demonstration, and keep its cycles."""
    configuration = demo_configuration()
    loop = Loop(build(configuration, speed=None))
    kept: Kept = []
    loop.listeners.append(lambda record, frame: kept.append((record, frame)))
    loop.run(Limits(frames=frames))
    recorded = Recorded(
        configuration=to_be_recorded(configuration),
        camera=configuration.camera_model,
        sizes={name: detector.target_shape for name, detector in loop.parts.cycle.detectors.items()},
    )
    return kept, recorded


def measure_all(frames: int = FRAMES) -> list[Row]:
    """Return every row of the report.

    Args:
        frames: How many frames to record.

    Returns:
        The rows.
    """
    kept, recorded = kept_run(frames)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run"
        for what, options in OPTIONS.items():
            with closing(RecordingWriter(path, recorded, options)) as writer:
                times_s = [_timed(partial(writer.write, *each)) for each in kept]
            rows.append(_row(what, times_s, path.stat().st_size))
        with closing(Recorder(RecordingWriter(path, recorded), is_live=False)) as recorder:
            handed_s = [_timed(partial(recorder, *each)) for each in kept]
        rows.append(_row("handing a cycle to the recorder, in the loop", handed_s, 0))
        with closing(JournalWriter(Path(name) / "journal", recorded.configuration)) as journal:
            times_s = [_timed(partial(journal.write, record)) for record, _ in kept]
        rows.append(_row("journal, in its thread", times_s, (Path(name) / "journal").stat().st_size))
    return rows


def _timed(work: Callable[[], object]) -> float:
    began_s = thread_time()
    work()
    return thread_time() - began_s


def _row(what: str, times_s: Sequence[float], size: float) -> Row:
    return Row(
        what=what,
        median_us=statistics.median(times_s) * 1e6,
        mean_us=statistics.fmean(times_s) * 1e6,
        cycle_bytes=size / len(times_s),
    )


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| a cycle | median µs | mean µs | bytes |", "| --- | ---: | ---: | ---: |"]
    lines += [f"| {row.what} | {row.median_us:.0f} | {row.mean_us:.0f} | {row.cycle_bytes:.0f} |" for row in rows]
    return "\n".join(lines)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=FRAMES)
    print(markdown(measure_all(parser.parse_args().frames)))


if __name__ == "__main__":
    main()
