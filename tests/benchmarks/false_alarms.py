"""How often something is seen that is not there: clutter without a target."""

from __future__ import annotations

from functools import cache

import fiducials
import ours
import tutorial
from msgspec import Struct
from msgspec.structs import replace
from part import Part, table
from samples import rate
from workload import over_seeds

from stadimeter.core.detection import DetectionStatus
from support.scenes import draw
from support.scenes.backdrop import ClutterBackdrop
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene

DISTRACTORS = 12
LEAST_TUTORIAL_RADIUS_PX = 10
"""The ball tutorial draws nothing smaller than this, in its own reduced picture."""

BUSY_EVERY = 4
"""Of so many scenes, one is taken with angular things of the ball's colour on top too."""

ALIKE_APART = 500_000
"""Each seed stands for two scenes of clutter full of the ball's colour: its own, and that of the seed so far on."""

OF_OURS = ("ball", "ball of any colour", "sheet", "disc", "tag")


class Alarm(Struct, frozen=True, kw_only=True):
    """Whether one method saw something in one empty scene."""

    row: str
    method: str
    seed: int
    raised: bool


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Look for everything in so many empty scenes."""
    alarms = over_seeds(alarms_of, range(first_seed, first_seed + frames), workers)
    by_row: dict[tuple[str, str], list[Alarm]] = {}
    for alarm in alarms:
        by_row.setdefault((alarm.row, alarm.method), []).append(alarm)
    rows, facts = [], {}
    for (row, method), of_row in by_row.items():
        share = sum(alarm.raised for alarm in of_row) / len(of_row)
        seeds = ", ".join(str(alarm.seed) for alarm in of_row if alarm.raised) if 0 < share < 0.02 else ""
        rows.append((row, method, str(len(of_row)), f"{1000 * share:.1f}", rate(share, len(of_row)), seeds))
        facts[f"alarms {method} {row}"] = share
    text = (
        f"{frames} scenes of clutter without any target, one in ten of which has a shape of the ball's colour; a "
        f"fourth of them also with {DISTRACTORS} angular shapes of that colour on top; and twice as many scenes of "
        "clutter that is full of it. "
        "No rectangle of the clutter has an aspect from 1.22 to 1.62, and no ellipse is rounder "
        "than 0.8 to 1: those would be sheets and discs. Seeds are named where alarms are rare.\n\n"
    )
    head = ("scene", "method", "frames", "false alarms per 1000 frames", "in % (95 % interval)", "seeds")
    return Part(title="False alarms", text=text + table(head, rows), facts=facts)


def alarms_of(seed: int) -> list[Alarm]:
    """Look for everything in one empty scene, and for balls among things of their colour."""
    empty = draw.empty_scene(seed)
    image = render(empty).image
    found = _of_ours(empty, "clutter", OF_OURS) + [
        Alarm(row="clutter", method=name, seed=seed, raised=bool(finder(image))) for name, finder in _finders().items()
    ]
    raised = {
        "tutorial ball": tutorial.ball_radius_px(image) is not None,
        "tutorial ball, radius > 10 px": _tutorial_draws(image),
        "tutorial sheet": tutorial.sheet_box(image) is not None,
    }
    found += [Alarm(row="clutter", method=name, seed=seed, raised=each) for name, each in raised.items()]
    room = replace(empty, backdrop=RoomBackdrop())
    found += _of_ours(room, "room", ("ball of any colour",))
    for alike in (seed, seed + ALIKE_APART):
        full = replace(draw.empty_scene(alike), backdrop=ClutterBackdrop(like_target=1.0))
        found += _of_ours(full, "clutter of the ball's colour", ("ball",))
    if seed % BUSY_EVERY == 0:
        busy = draw.empty_scene(seed, distractors=DISTRACTORS)
        found += _of_ours(busy, f"clutter, {DISTRACTORS} distractors", ("ball",))
    return found


def _of_ours(scene: Scene, row: str, targets: tuple[str, ...]) -> list[Alarm]:
    image = render(scene).image
    alarms = []
    for target in targets:
        detection = ours.detector(target, scene.camera).detect(ours.framed(image))
        raised = detection.status is DetectionStatus.FOUND
        alarms.append(Alarm(row=row, method=f"stadimeter {target}", seed=scene.seed, raised=raised))
    return alarms


def _tutorial_draws(image) -> bool:
    radius = tutorial.ball_radius_px(image)
    scale = tutorial.BALL_WIDTH_PX / image.shape[1]
    return radius is not None and radius * scale > LEAST_TUTORIAL_RADIUS_PX


@cache
def _finders() -> dict[str, fiducials.Finder]:
    return fiducials.finders()
