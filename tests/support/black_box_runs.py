"""Runs with a black box, each by a seed: what happens and when, how much a clip holds, and what goes wrong.

What a clip must hold is worked out from what a listener of the same run has taken down: every cycle, from ``before``
the first event to ``after`` the last, its decision, and each picture that was due.

Run ``PYTHONPATH=tests python -m support.black_box_runs 200`` for the full count; of each five seeds, two are alarms,
one is a fault, one a disk that fills up, and one the end of the page that started the run, by SIGKILL.
"""

from __future__ import annotations

import math
import os
import random
import signal
import sys
import tempfile
import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.request import Request, urlopen

from msgspec import Struct, field

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings import black_box
from stadimeter.cli.run_services import open_black_box
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay.recording_reader import McapRecording, read_mcap
from stadimeter.workbench.replay.replay import replay_run
from support.browser import served

KINDS = ("alarm", "alarm", "fault", "disk", "page")

# How long the disk is full; and how late the thread that writes may be, which the run is ahead of.
FULL_S, LATE_S = 6.0, 2.5

CAMERA = """
[camera]
driver = "simulated"
rate = "{rate} Hz"
[camera.model]
width_px = 160
height_px = 120
fx_px = 150.0
fy_px = 150.0
cx_px = 79.5
cy_px = 59.5
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"
[actuators.motor]
driver = "simulated"
[rules.near]
actuator = "motor"
when = {{ below = "1.2 m" }}
on_delay = "{delay} s"
"""


class Scene(Struct, frozen=True, kw_only=True):
    """What happens in one run, and how its black box is set.

    Attributes:
        near_s: When the ball comes near.
        faults_s: When the camera stands still.
        killed_s: How long after the beginning of the clip the page is killed.
        full_s: When the disk becomes full; infinite for never.
    """

    seed: int
    kind: str
    rate_hz: int
    delay_s: float
    before_s: float
    after_s: float
    pictures_hz: int
    seconds: float
    near_s: tuple[float, ...] = ()
    faults_s: tuple[float, ...] = ()
    killed_s: float = 0.0
    full_s: float = math.inf

    def text(self) -> str:
        """Return it as a configuration."""
        path = ['{ at = "0 s", x = "2.2 m", y = "0 m" }']
        for at_s in self.near_s:
            path += [
                f'{{ at = "{at_s + later_s:.2f} s", x = "{x_m} m", y = "0 m" }}'
                for later_s, x_m in ((0, 2.2), (0.6, 0.8), (1.0, 0.8), (1.6, 2.2))
            ]
        faults = [f'{{ at = "{at_s:.2f} s", for = "1 s", kind = "freeze-camera" }}' for at_s in self.faults_s]
        box = f'before = "{self.before_s} s"\nafter = "{self.after_s} s"\nrate = "{self.pictures_hz} Hz"'
        world = f"loop = false\npath = [{', '.join(path)}]\nfaults = [{', '.join(faults)}]\n"
        return f"{CAMERA.format(rate=self.rate_hz, delay=self.delay_s)}\n[black_box]\n{box}\n[world]\n{world}"


def scene_of(seed: int) -> Scene:
    """Return the scene of a seed."""
    rng, kind = random.Random(seed), KINDS[seed % len(KINDS)]  # noqa: S311 - a scene, no secret
    moments = sorted(rng.uniform(3, 22) for _ in range(rng.randint(1, 4)))
    spread = [at_s for number, at_s in enumerate(moments) if number == 0 or at_s - moments[number - 1] > 2.5]
    faults = spread[::2] if kind == "fault" else ()
    near = [at_s for at_s in spread if at_s not in faults] if kind != "page" else [3.0]
    after_s = round(rng.uniform(0.2, 5), 1)
    return Scene(
        seed=seed,
        kind=kind,
        rate_hz=rng.choice((10, 15, 30)),
        delay_s=rng.choice((0, 0.2)),
        before_s=round(rng.uniform(1, 6), 1),
        after_s=after_s,
        killed_s=rng.uniform(0, after_s),
        pictures_hz=rng.choice((2, 5, 10, 30)),
        seconds=24.0 if kind != "page" else 600.0,
        near_s=tuple(near),
        faults_s=tuple(faults),
        full_s=rng.uniform(2, 20) if kind == "disk" else math.inf,
    )


class Taken(Struct):
    """What a listener has taken down of a run: its cycles, which pictures were due, and the clip of each event."""

    pictures_hz: float
    records: list[CycleRecord] = field(default_factory=list)
    due: set[int] = field(default_factory=set)
    events: list[tuple[float, str]] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    newest_s: float = -1e9

    def take(self, loop: Loop, record: CycleRecord, frame: Frame | None) -> None:
        """Take down a cycle."""
        self.records.append(record)
        if frame is not None and frame.captured_at_s - self.newest_s >= 0.9 / self.pictures_hz:
            self.newest_s = frame.captured_at_s
            self.due.add(frame.sequence)
        for event in record.decision.events:
            if event.kind in {EventKind.RAISED, EventKind.FAULT}:
                self.events.append((record.observation.now_s, loop.reporter.clips[event.source]))


def run(folder: Path, scene: Scene, each: Callable[[float], None] = lambda _now_s: None) -> Taken:
    """Run a scene as fast as it goes; ``each`` is called with the time of each cycle."""
    path = folder / "door.toml"
    path.write_text(scene.text())
    loop = Loop(build(load_configuration(path), speed=None))
    taken = Taken(scene.pictures_hz)
    loop.services.tell = taken.told.append
    with ExitStack() as closing:
        open_black_box(loop, closing)
        loop.listeners.append(lambda record, frame: taken.take(loop, record, frame))
        loop.listeners.append(lambda record, _frame: each(record.observation.now_s))
        loop.run(Limits(seconds=scene.seconds))
    return taken


def complaints(folder: Path, scene: Scene, taken: Taken, events: Sequence[tuple[float, str]]) -> Iterator[str]:
    """Yield what is wrong with the clips of some events."""
    times = [record.observation.now_s for record in taken.records]
    for at_s, name in events:
        path = folder / "recordings" / "clips" / name
        if not path.exists():
            yield f"{name} of {at_s:.2f} s is not there"
            continue
        clip = read_mcap(path)
        held = [cycle.now_s() for cycle in clip.cycles()]
        if held[0] > max(times[0], at_s - scene.before_s) or held[-1] < min(times[-1], at_s + scene.after_s):
            yield f"{name} holds {held[0]:.2f} to {held[-1]:.2f} s, and {at_s:.2f} s needs more"
        begin = bisect_left(times, held[0])
        yield from _differences(clip, taken, begin)


def _differences(clip: McapRecording, taken: Taken, begin: int) -> Iterator[str]:
    """Yield in which cycles a clip, or its replay, is not what the run saw and decided."""
    name = clip.path.name
    if clip.is_cut_off():
        yield f"{name} is not whole"
    pictures = {image.sequence for _, image in clip.cycles_and_images() if image is not None}
    due = set[int]()
    number = begin - 1
    for number, (cycle, observation, decision) in enumerate(replay_run(clip, None), start=begin):
        record = taken.records[number]
        if observation.frame is not None and observation.frame.sequence in taken.due:
            due.add(observation.frame.sequence)
        if observation != record.observation or cycle.record().decision != record.decision:
            yield f"{name}: cycle {number} is another than that of the run"
            return
        if decision != record.decision:
            yield f"{name}: cycle {number} replays to another decision"
            return
    if pictures != due:
        yield f"{name}: {len(pictures)} pictures, and {len(due)} were due"


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """Give a folder a disk of its own, with little room."""
    if os.system(f"mount -t tmpfs -o size=80m tmpfs '{folder}' 2>/dev/null"):  # noqa: S605
        raise PermissionError("only root may mount")
    floor, black_box.FREE_MIN_BYTES = black_box.FREE_MIN_BYTES, 0  # clips may take all of it
    try:
        yield
    finally:
        black_box.FREE_MIN_BYTES = floor
        os.system(f"umount -l '{folder}'")  # noqa: S605


def try_full_disk(folder: Path, scene: Scene) -> Iterator[str]:
    """Yield what is wrong after a run whose disk is full from some moment on, for 6 s, and then has room again."""
    full_s, filler = scene.full_s, folder / "recordings" / "filler"

    def each(now_s: float) -> None:
        is_full = full_s <= now_s < full_s + FULL_S
        if is_full and not filler.exists():
            with suppress(OSError), filler.open("wb", buffering=0) as file:
                while True:
                    file.write(bytes(4096))
        if not is_full:
            filler.unlink(missing_ok=True)

    (folder / "recordings").mkdir()
    with small_disk(folder / "recordings"):
        taken = run(folder, scene, each)
        if taken.records[-1].observation.now_s < scene.seconds - 1:
            yield "the run has ended early"
        yield from complaints(
            folder, scene, taken, [event for event in taken.events if _is_spared(event, taken, scene)]
        )
    is_hit = any(full_s + 0.5 < at_s < full_s + FULL_S - 1 for at_s, _ in taken.events)
    if is_hit and not any("No space left" in words for words in taken.told):
        yield f"the full disk is not said: {taken.told}"
    if strange := [words for words in taken.told if "No space left" not in words]:
        yield f"something else is said: {strange}"


def _is_spared(event: tuple[float, str], taken: Taken, scene: Scene) -> bool:
    """Return whether the clip of an event was finished before the disk was full, or begun when it had room again."""
    first_s, last_s = (choose(at_s for at_s, name in taken.events if name == event[1]) for choose in (min, max))
    return last_s + scene.after_s + LATE_S < scene.full_s or first_s > scene.full_s + FULL_S + LATE_S


def try_simulated(folder: Path, scene: Scene) -> Iterator[str]:
    """Yield what is wrong after a run in which all goes well."""
    taken = run(folder, scene)
    if not taken.events:
        yield "nothing has happened"
    if taken.told:
        yield f"something was told: {taken.told}"
    yield from complaints(folder, scene, taken, taken.events)


def try_page(folder: Path, scene: Scene) -> Iterator[str]:
    """Yield what is wrong with the clip of a run whose page, which has started it, is killed during the clip."""
    clips = folder / "recordings" / "clips"
    with served(folder, scene.text(), runs=False) as here:
        headers = {"Origin": here.url, "Content-Type": "application/json"}
        with urlopen(Request(f"{here.url}/api/v1/run/start", b"{}", headers), timeout=60):  # noqa: S310 - our own page
            pass
        eventually(lambda: any(each.stat().st_size for each in clips.glob("*.mcap")), 120)
        time.sleep(scene.killed_s)  # any moment of what comes after
        here.page.send_signal(signal.SIGKILL)
        here.page.wait()
        (clip,) = (read_mcap(each) for each in clips.glob("*.mcap"))
        with suppress(AssertionError):
            eventually(lambda: not clip.is_cut_off(), 60)
    if clip.is_cut_off():
        yield "the clip is not whole"
    decided = [cycle.record().decision == decision for cycle, _, decision in replay_run(clip, None)]
    if not decided or not all(decided):
        yield "the clip replays to another decision, or is empty"


def try_seed(seed: int) -> list[str]:
    """Return what is wrong with the run of a seed."""
    scene = scene_of(seed)
    tries = {"disk": try_full_disk, "page": try_page}
    with tempfile.TemporaryDirectory(prefix="box-") as name:
        return [
            f"seed {seed} ({scene.kind}): {words}" for words in tries.get(scene.kind, try_simulated)(Path(name), scene)
        ]


def main() -> None:
    """Try as many seeds as are asked for, and print what is wrong."""
    first, last = (int(word) for word in [*sys.argv[1:], "0", "0"][:2])
    first, last = (first, last) if last else (0, first)
    good: Counter[str] = Counter()
    for seed in range(first, last):
        wrong = try_seed(seed)
        good[scene_of(seed).kind] += not wrong
        print(*wrong, sep="\n", end="\n" if wrong else "", flush=True)
    print(f"{sum(good.values())} of {last - first} runs are whole: {dict(good)}")


if __name__ == "__main__":
    main()
