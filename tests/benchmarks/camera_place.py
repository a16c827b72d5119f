"""How well the camera's own pose is found from tags whose places are known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from part import Part, table
from samples import grouped, rate
from workload import over_seeds

from stadimeter.core.camera_pose import CameraPose
from stadimeter.core.frame import Frame
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.perception.prediction import CameraLocator
from support.scenes import draw, nuisances
from support.scenes.placed import PlacedScene, moved, placed_scene
from support.scenes.render import render
from support.scenes.scene import Scene

PLACE_SIGMA_M, FACING_SIGMA_RAD = 0.005, math.radians(0.5)
MOVED_M = 0.2
WITHIN_6, WITHIN_3 = 12.592, 7.815
"""95 % of chi-square with six and with three degrees of freedom."""

EXACT: dict[str, Callable[[Scene], Scene]] = {
    "4 tags, places exact": lambda scene: scene,
    "4 tags, places exact, noise 8": nuisances.noise(8),
    "4 tags, places exact, JPEG 80": nuisances.jpeg(80),
}
PLACED, MOVED, TWO, ONE = (
    "4 tags, placed to 5 mm and 0.5°",
    "4 tags likewise, one moved by 20 cm",
    "2 tags likewise",
    "1 tag likewise",
)


class PlaceSample(Struct, frozen=True, kw_only=True):
    """The pose of one camera as it was found.

    Attributes:
        off_share: How far it is from its true place, as a share of the distance of the tags; NaN if it is not known.
        off_rad: By how much it is turned from its true direction.
        square: The same in standard deviations, squared, with six degrees of freedom.
        place_square: Of the place alone.
        moved: The tags that are said to have moved.
        expected: Those that have.
    """

    row: str
    off_share: float = math.nan
    off_rad: float = math.nan
    square: float = math.nan
    place_square: float = math.nan
    moved: tuple[int, ...] = ()
    expected: tuple[int, ...] = ()
    reason: str = ""


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Find the camera's pose in so many pictures of each row."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    rows = grouped(samples, lambda sample: sample.row)
    head = ["tags of 10 cm at 1–4 m", "pictures", "known %", "place, %", "turn, °", "6 d.o.f. %", "place %", "moved %"]
    text = (
        "A camera of 1280 × 960 px with a focal length of 1000 px, one tag of AprilTag 36h11 in each quarter of the "
        "picture, turned away by up to 50°, on clutter. Median / p95 of the error of the place in % of the mean "
        "distance of the tags, and of the turn in degrees; how often the 95 % region holds the truth; and how often "
        "exactly the tags that have moved were named, none where none has. In brackets the 95 % interval of a share."
        "\n\n" + table(head, [_cells(name, of_row) for name, of_row in rows.items()])
    )
    return Part(title="Where the camera is", text=text, facts=_facts(rows))


def samples_of(seed: int) -> list[PlaceSample]:
    """Find the camera in every row of one seed."""
    exact = placed_scene(seed)
    found = [_sample(name, exact, _frame(nuisance(exact.scene))) for name, nuisance in EXACT.items()]
    placed = placed_scene(seed, place_sigma_m=PLACE_SIGMA_M, facing_sigma_rad=FACING_SIGMA_RAD)
    frame = _frame(placed.scene)
    found.append(_sample(PLACED, placed, frame))
    found.append(_sample(MOVED, moved(placed, MOVED_M), frame, (placed.landmarks.tags[0].number,)))
    found += [_sample(name, _known(placed, count), frame) for name, count in ((TWO, 2), (ONE, 1))]
    return found


def _known(scene: PlacedScene, count: int) -> PlacedScene:
    """Return a scene of whose tags a configuration knows the first few."""
    return replace(scene, landmarks=replace(scene.landmarks, tags=scene.landmarks.tags[:count]))


def _frame(scene: Scene) -> Frame:
    made = render(scene)
    return Frame(made.image, 0.0, 0, subsampling=made.subsampling)


def _sample(row: str, scene: PlacedScene, frame: Frame, expected: tuple[int, ...] = ()) -> PlaceSample:
    locator = CameraLocator(scene.landmarks, _detector(), Viewpoint())
    pose = locator.locate(frame, scene.scene.camera.for_frame(frame))
    if pose.position_m is None:
        return PlaceSample(row=row, moved=pose.moved, expected=expected, reason=pose.reason)
    off = error_of(pose, scene)
    covariance = np.reshape(pose.covariance, (6, 6))
    return PlaceSample(
        row=row,
        off_share=float(np.linalg.norm(off[:3])) / scene.distance_m,
        off_rad=float(np.linalg.norm(off[3:])),
        square=float(off @ np.linalg.solve(covariance, off)),
        place_square=float(off[:3] @ np.linalg.solve(covariance[:3, :3], off[:3])),
        moved=pose.moved,
        expected=expected,
    )


def error_of(pose: CameraPose, scene: PlacedScene) -> np.ndarray:
    """Return by how much a pose is off: its place, and its turn about the room's axes."""
    x, y, z, w = pose.orientation
    # The matrix of a quaternion; its columns are the body's axes: forwards, left, up.
    body = np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
    )
    turn = np.column_stack((-body[:, 1], -body[:, 2], body[:, 0]))
    return np.concatenate((np.array(pose.position_m) - scene.position_m, cv2.Rodrigues(turn @ scene.turn.T)[0].ravel()))


@cache
def _detector() -> TagDetector:
    return TagDetector("landmarks", TagOptions.model_validate({"side": "10 cm"}))


def _cells(name: str, samples: Sequence[PlaceSample]) -> list[str]:
    known = [sample for sample in samples if not math.isnan(sample.off_share)]
    return [
        name,
        str(len(samples)),
        f"{100 * len(known) / len(samples):.1f}",
        _both([100 * sample.off_share for sample in known]),
        _both([math.degrees(sample.off_rad) for sample in known]),
        _share([sample.square < WITHIN_6 for sample in known]),
        _share([sample.place_square < WITHIN_3 for sample in known]),
        _share([sample.moved == sample.expected for sample in samples]),
    ]


def _share(held: Sequence[bool]) -> str:
    return rate(float(np.mean(held)) if held else math.nan, len(held))


def _both(values: Sequence[float]) -> str:
    return f"{np.median(values):.2f} / {np.percentile(values, 95):.2f}" if values else "–"


def _facts(rows: dict[str, list[PlaceSample]]) -> dict[str, float]:
    facts = {}
    for name, samples in rows.items():
        known = [sample for sample in samples if not math.isnan(sample.off_share)]
        if known:
            facts[f"place {name}"] = float(np.percentile([sample.off_share for sample in known], 95))
            facts[f"place {name} turn"] = float(np.percentile([math.degrees(sample.off_rad) for sample in known], 95))
            facts[f"place {name} coverage"] = float(np.mean([sample.square < WITHIN_6 for sample in known]))
    return facts
