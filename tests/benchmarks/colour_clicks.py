"""How often a ball is found with the range of colours that one click on it gives, or two.

``python tests/benchmarks/colour_clicks.py`` prints the table of docs/benchmarks/web.md. Each picture goes through the
page's own operation, ``setup_operations.colour``. A person is taken to click near the middle of the ball: at random,
with a standard deviation of a quarter of its radius, and never further out than two thirds. Where it is not found
afterwards, they click once more, elsewhere on it.

Afterwards the ball is looked for as a run does, with the range alone. It counts as found where its centre is off by no
more than a third of its radius. Whether its size is right within a tenth, too, is counted apart: it is rather a matter
of the detector than of the range.
"""

from __future__ import annotations

import argparse
import csv
import math
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct
from part import table

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DETECTORS, DriverContext, load_driver
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.server.operations import Desk
from stadimeter.workbench.server.setup_operations import colour, setup_of
from support.scenes import draw
from support.scenes.hard_balls import BACKDROPS, hard_ball
from support.scenes.render import render

REAL = Path(__file__).resolve().parents[3] / "shared" / "data"
TENNIS = ("44.5_0", "44.5_20", "89_0", "89_30", "116_0", "116_40")
VIDEO_FRAMES = (38, 250, 500, 750)
TENNIS_M, TENNIS_FOCAL_PX = 0.064, 1449.0
REFERENCE = "29,86,6:64,255,255"
"""With this range, chosen by hand, the tennis ball is found in all of its pictures; the tape says its size."""

CLICK_SIGMA, CLICK_FARTHEST = 0.25, 2 / 3
CENTRE_SHARE, SIZE_SHARE = 1 / 3, 0.1


class Ball(Struct, frozen=True, kw_only=True, eq=False):
    """A picture, and where the ball truly is."""

    name: str
    kind: str
    frame: Frame
    x_px: float
    y_px: float
    radius_px: float


class Outcome(Struct, frozen=True, kw_only=True):
    """After how many clicks a ball was found, None if not after two; and whether its size was right."""

    ball: str
    kind: str
    clicks: int | None
    has_size: bool = False
    took_s: float


def rendered(count: int, first_seed: int = draw.REPORT_SEEDS.start) -> Iterator[Ball]:
    """Yield balls as they are met, on each backdrop equally often."""
    for seed in range(first_seed, first_seed + count):
        hard = hard_ball(seed, (20.0, 70.0), backdrop=BACKDROPS[seed % len(BACKDROPS)])
        made = render(hard.scene)
        x_px, y_px = made.truth.outline_px.mean(axis=0).tolist()
        yield Ball(
            name=str(seed),
            kind=f"rendered: {hard.backdrop}",
            frame=Frame(made.image, 0.0, seed),
            x_px=x_px,
            y_px=y_px,
            radius_px=hard.radius_px,
        )


def photographed() -> Iterator[Ball]:
    """Yield the pictures of a real tennis ball, whose size follows from the tape."""
    folder = REAL / "tennis_ball"
    with (folder / "truth.csv").open(newline="", encoding="utf-8") as file:
        depths_m = {row["file"]: float(row["ball_centre_depth_m"]) for row in csv.DictReader(file)}
    for name in TENNIS:
        frame = open_picture(folder / "images" / f"{name}.jpg")
        seen = detected(frame, REFERENCE)
        radius_px = TENNIS_FOCAL_PX * TENNIS_M / 2 / depths_m[f"{name}.jpg"]
        x_px, y_px = seen.centre_px
        yield Ball(name=name, kind="photograph", frame=frame, x_px=x_px, y_px=y_px, radius_px=radius_px)


def filmed() -> Iterator[Ball]:
    """Yield frames of the video of a striped ball in a hand, with the outlines that were fitted apart."""
    with (Path(__file__).parent / "ball_video_outline.csv").open(newline="", encoding="utf-8") as file:
        outlines = {int(row["frame"]): row for row in csv.DictReader(file)}
    video = cv2.VideoCapture(str(REAL / "ball_video" / "green_ball.mp4"))
    for wanted in VIDEO_FRAMES:
        number = min(outlines, key=lambda frame: abs(frame - wanted))
        video.set(cv2.CAP_PROP_POS_FRAMES, number)
        _, image = video.read()
        x_px, y_px, radius_px = (float(outlines[number][key]) for key in ("x_px", "y_px", "radius_px"))
        frame = Frame(np.asarray(image, np.uint8), 0.0, number, subsampling="4:2:0")
        yield Ball(name=f"frame {number}", kind="video", frame=frame, x_px=x_px, y_px=y_px, radius_px=radius_px)
    video.release()


def detected(frame: Frame, colour_range: str) -> Detection:
    """Look for a ball of any size with a range, as a run does before it knows the lens."""
    model = load_driver(DETECTORS, "ball")
    options = model.model_validate({"diameter": "1 m", "hsv": colour_range})
    found: Detection = options.build(DriverContext(name="ball", clock=SteppedClock())).detect(frame)
    return found


def clicked(ball: Ball, folder: Path) -> Outcome:
    """Click on a ball until it is found, twice at most."""
    desk = Desk(configuration=folder / "stadimeter.toml")
    setup_of(desk).shown = ball.frame
    rng, began_s = np.random.default_rng(ball.frame.sequence), time.monotonic()
    for clicks in (1, 2):
        try:
            reply = colour(desk, {"clicks": [_click(ball, rng)]})
        except ConfigError:
            continue  # told to click elsewhere
        took_s = (time.monotonic() - began_s) / clicks
        seen = detected(ball.frame, reply.data["range"])
        if _is_found(ball, seen):
            has_size = abs(seen.width_px / (2 * ball.radius_px) - 1) <= SIZE_SHARE
            return Outcome(ball=ball.name, kind=ball.kind, clicks=clicks, has_size=has_size, took_s=took_s)
    return Outcome(ball=ball.name, kind=ball.kind, clicks=None, took_s=(time.monotonic() - began_s) / 2)


def _click(ball: Ball, rng: np.random.Generator) -> list[float]:
    while True:
        across, down = rng.normal(0.0, CLICK_SIGMA, 2)
        if math.hypot(across, down) <= CLICK_FARTHEST:
            return [ball.x_px + across * ball.radius_px, ball.y_px + down * ball.radius_px]


def _is_found(ball: Ball, seen: Detection) -> bool:
    off_px = math.dist(seen.centre_px, (ball.x_px, ball.y_px))
    return seen.status is DetectionStatus.FOUND and off_px <= CENTRE_SHARE * ball.radius_px


def interval(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (E. B. Wilson, JASA 22, 1927)."""
    z, share = 1.96, count / of
    middle, reach = share + z * z / (2 * of), z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return max(0.0, (middle - reach) / (1 + z * z / of)), min(1.0, (middle + reach) / (1 + z * z / of))


def _real_first(kind: str) -> tuple[bool, str]:
    return kind.startswith("rendered"), kind


def report(outcomes: Sequence[Outcome]) -> str:
    """Return the table: shares after one click and after two, for real pictures first, all, and each kind."""
    kinds = {each.kind for each in outcomes}
    groups = {
        "real": [each for each in outcomes if not each.kind.startswith("rendered")],
        "rendered": [each for each in outcomes if each.kind.startswith("rendered")],
        "all": outcomes,
        **{kind: [each for each in outcomes if each.kind == kind] for kind in sorted(kinds, key=_real_first)},
    }
    head = (
        "pictures",
        "number",
        "found after one click",
        "95 % interval",
        "after two",
        "95 % interval",
        "with its size",
        "s a click",
    )
    return table(head, [_row(name, group) for name, group in groups.items() if group])


def _row(name: str, group: Sequence[Outcome]) -> tuple[str, ...]:
    cells = [name, str(len(group))]
    for most in (1, 2):
        count = sum(each.clicks is not None and each.clicks <= most for each in group)
        low, high = interval(count, len(group))
        cells += [f"{count / len(group):.1%}", f"{low:.0%} to {high:.0%}"]
    sized = sum(each.has_size for each in group)
    return (*cells, f"{sized / len(group):.1%}", f"{np.median([each.took_s for each in group]):.1f}")


def run(balls: Iterable[Ball]) -> list[Outcome]:
    """Click on every ball, and say at once where one was not found."""
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        for ball in balls:
            outcomes.append(clicked(ball, Path(folder)))
            if outcomes[-1].clicks != 1:
                print(f"{ball.kind} {ball.name}: {outcomes[-1].clicks or 'not found after two'} clicks", flush=True)
            elif not outcomes[-1].has_size:
                print(f"{ball.kind} {ball.name}: found, and measured too small or too large", flush=True)
    return outcomes


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rendered", type=int, default=100)
    parser.add_argument("--tuning", action="store_true", help="scenes for choosing constants, not for the report")
    options = parser.parse_args()
    first_seed = draw.TUNING_SEEDS.start if options.tuning else draw.REPORT_SEEDS.start
    real = [] if options.tuning or not REAL.is_dir() else [*photographed(), *filmed()]
    print(report(run([*real, *rendered(options.rendered, first_seed)])))


if __name__ == "__main__":
    main()
