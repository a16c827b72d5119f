"""Runs with a black box, each by a seed: what happens when, how much a clip holds, and when the camera stands still.

What a clip must hold is worked out from what a listener of the same run has taken down: every cycle, from ``before``
the first event to ``after`` the last, its decision, and each picture that was due.
"""

from __future__ import annotations

import random
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from msgspec import Struct, field

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.run_services import open_black_box
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.workbench.replay import McapRecording, read_mcap, replay_run

CAMERA = """
[camera]
driver = "simulated"
rate = "{rate} Hz"
[camera.model]
width_px = 160
height_px = 120
fx_px = 150.0
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
    """

    seed: int
    rate_hz: int
    delay_s: float
    before_s: float
    after_s: float
    pictures_hz: int
    seconds: float
    near_s: tuple[float, ...] = ()
    faults_s: tuple[float, ...] = ()

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
    rng = random.Random(seed)  # noqa: S311 - a scene, no secret
    moments = sorted(rng.uniform(3, 22) for _ in range(rng.randint(1, 4)))
    spread = [at_s for number, at_s in enumerate(moments) if number == 0 or at_s - moments[number - 1] > 2.5]
    faults = spread[::2] if seed % 2 else []
    near = [at_s for at_s in spread if at_s not in faults]
    after_s = round(rng.uniform(0.2, 5), 1)
    return Scene(
        seed=seed,
        rate_hz=rng.choice((10, 15, 30)),
        delay_s=rng.choice((0, 0.2)),
        before_s=round(rng.uniform(1, 6), 1),
        after_s=after_s,
        pictures_hz=rng.choice((2, 5, 10, 30)),
        seconds=24.0,
        near_s=tuple(near),
        faults_s=tuple(faults),
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


def run(folder: Path, scene: Scene) -> Taken:
    """Run a scene as fast as it goes."""
    path = folder / "door.toml"
    path.write_text(scene.text())
    loop = Loop(build(load_configuration(path), speed=None))
    taken = Taken(scene.pictures_hz)
    loop.services.tell = taken.told.append
    with ExitStack() as closing:
        open_black_box(loop, closing)
        loop.listeners.append(lambda record, frame: taken.take(loop, record, frame))
        loop.run(Limits(seconds=scene.seconds))
    return taken


def complaints(folder: Path, scene: Scene, taken: Taken) -> Iterator[str]:
    """Yield what is wrong with the clips of its events."""
    times = [record.observation.now_s for record in taken.records]
    for at_s, name in taken.events:
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


def try_seed(seed: int, folder: Path) -> Iterator[str]:
    """Yield what is wrong after the run of a seed."""
    scene = scene_of(seed)
    taken = run(folder, scene)
    if not taken.events:
        yield "nothing has happened"
    if taken.told:
        yield f"something was told: {taken.told}"
    yield from complaints(folder, scene, taken)
