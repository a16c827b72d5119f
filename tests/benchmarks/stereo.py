"""How well two cameras measure: by triangulation alone, by the target's size alone, and joined."""

from __future__ import annotations

import math

import numpy as np
import ours
from msgspec.structs import replace
from part import Part, table
from samples import Sample, grouped, rate, summarise
from workload import over_seeds

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.stereo import measure_pair
from support.scenes import draw
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene, Truth
from support.scenes.target import Target
from support.stereo import ScenePair, calibrated_rig, pair_of, true_rig

GROSS = 0.05
NEAR_M, FAR_M = 0.5, 3.0
MAX_TILT_DEG = 45
TARGETS = ("ball", "sheet", "tag", "disc")
TOGETHER, BY_SIZE, JOINED = WAYS = ("together", "by size", "joined")
REFUSED, DISAGREE = "refused", "disagree"
MAX_ROLL_RAD = 0.5
TOLERANCE_SHARE = 0.005
SIZES_M = {"ball": draw.TENNIS_M, "sheet": math.sqrt(math.prod(draw.SHEET_M)), "tag": draw.TAG_M, "disc": draw.DISC_M}
WALL = PlainBackdrop(bgr=(80, 85, 90))


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many pairs of each target, each with two cameras of its own that were calibrated with a board."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    head = ["target", "pairs", "measured", "refused", "disagree"]
    for way in WAYS:
        head += [f"{way}: median / p95 %", "95 % interval holds %"]
    text = (
        "Two cameras of 600 px at 640 × 480, 12 cm apart and not quite parallel. Each pair of pictures has cameras of "
        "its own, calibrated from 13 pairs of a board with corners off by 0.1 px and squares by 0.2 %. As stated, the "
        f"edge bias is off by {UNKNOWN_EDGE_BIAS_SIGMA_PX:g} px, the size of targets by {TOLERANCE_SHARE:.1%}. "
        f"Targets are {NEAR_M:g}–{FAR_M:g} m away, flat ones tilted by up to {MAX_TILT_DEG}°, on clutter, which is "
        "another one in the other picture; discs on a plain wall. *Together* is by triangulation, without the size. "
        "Pairs in which a picture shows no target, or another thing is taken for it, are not measured.\n\n"
    )
    rows = [_row(name, of_target) for name, of_target in grouped(samples, lambda sample: sample.row).items()]
    return Part(title="Two cameras", text=text + table(head, rows), facts=_facts(samples))


def _row(name: str, samples: list[Sample]) -> list[str]:
    of_way = grouped(samples, lambda sample: sample.method)
    found = sum(sample.measured_m is not None for sample in of_way[JOINED])
    counts = (len(of_way[JOINED]), found, *(len(of_way.get(each, ())) for each in (REFUSED, DISAGREE)))
    cells = [name, *map(str, counts)]
    for way in WAYS:
        summary = summarise(of_way[way], GROSS)
        cells += [summary.percents, rate(summary.coverage, found)]
    return cells


def _facts(samples: list[Sample]) -> dict[str, float]:
    facts = {}
    for name, of_way in grouped(samples, lambda sample: f"stereo {sample.row} {sample.method}").items():
        summary = summarise(of_way, GROSS)
        facts |= {f"{name} median": summary.median, f"{name} held": summary.coverage}
    return facts


def samples_of(seed: int) -> list[Sample]:
    """Measure one pair of each target, with one pair of cameras."""
    true = true_rig(seed)
    known = _as_bought(calibrated_rig(true, seed), seed)
    return [sample for name in TARGETS for sample in measure_scenes(name, seed, scenes_of(name, seed, true), known)]


def _as_bought(rig: StereoRig, seed: int) -> StereoRig:
    """Return the rig with lenses of whose edge bias is stated what is not known of it; it is off by as much as that."""
    bias_px = float(np.random.default_rng((seed, 64)).normal(0, UNKNOWN_EDGE_BIAS_SIGMA_PX))
    bought = {"edge_bias_px": bias_px, "edge_bias_sigma_px": UNKNOWN_EDGE_BIAS_SIGMA_PX}
    return replace(rig, left=replace(rig.left, **bought), right=replace(rig.right, **bought))


def scenes_of(name: str, seed: int, rig: StereoRig) -> ScenePair:
    """Draw a target on clutter that both cameras see whole."""
    rng = np.random.default_rng((seed, 63, TARGETS.index(name)))
    for _ in range(draw.MOST_ATTEMPTS):
        depth_m = float(np.exp(rng.uniform(math.log(NEAR_M), math.log(FAR_M))))
        x, y = rig.left.direction(float(rng.uniform(0, rig.left.width_px)), float(rng.uniform(0, rig.left.height_px)))
        pose = Pose(
            position_m=(x * depth_m, y * depth_m, depth_m),
            tilt_rad=math.radians(float(rng.uniform(0, MAX_TILT_DEG))),
            tilt_towards_rad=float(rng.uniform(0, math.tau)),
            roll_rad=float(rng.uniform(-MAX_ROLL_RAD, MAX_ROLL_RAD)),
        )
        backdrop = WALL if name == "disc" else ClutterBackdrop()  # where ellipses of the clutter are taken for discs
        scene = Scene(camera=rig.left, target=_target(name, pose, seed), seed=seed, backdrop=backdrop)
        pair = pair_of(scene, rig)
        if all(draw.is_whole(scene.target, scene.camera) for scene in (pair.left, pair.right)):
            return pair
    raise ValueError(f"seed {seed}: no {name} fits both pictures")


def _target(name: str, pose: Pose, seed: int) -> Target:
    """Return a target that is not quite as large as stated, by as much as its tolerance says."""
    larger = float(np.random.default_rng((seed, 65, TARGETS.index(name))).normal(1, TOLERANCE_SHARE))
    match name:
        case "ball":
            return BallTarget(position_m=pose.position_m, diameter_m=draw.TENNIS_M * larger)
        case "sheet":
            return SheetTarget(pose=pose, width_m=draw.SHEET_M[0] * larger, height_m=draw.SHEET_M[1] * larger)
        case "tag":
            return TagTarget(pose=pose, side_m=draw.TAG_M * larger, family=draw.TAG_FAMILY, number=seed % draw.TAGS)
        case _:
            return DiscTarget(pose=pose, diameter_m=draw.DISC_M * larger)


def measure_scenes(name: str, seed: int, pair: ScenePair, rig: StereoRig) -> list[Sample]:
    """Return what each way makes of a pair; without a distance where the target is not in both pictures."""
    left, right = render(pair.left), render(pair.right)
    sample = Sample(
        row=name,
        method=JOINED,
        seed=seed,
        apparent_px=left.truth.apparent_px,
        true_m=left.truth.distance_m,
        measured_m=None,
    )
    one, two = _seen(name, left, rig.left), _seen(name, right, rig.right)
    if one is None or two is None:
        return [replace(sample, method=way) for way in WAYS]
    joined, figures = measure_pair(one, two, rig)
    if figures is None:
        return [replace(sample, method=way) for way in (*WAYS, REFUSED)]
    return [
        replace(sample, method=TOGETHER, measured_m=figures.distance_m, sigma_m=figures.sigma_m),
        replace(sample, method=BY_SIZE, measured_m=figures.size_m, sigma_m=figures.size_sigma_m),
        replace(sample, measured_m=joined.distance_m, sigma_m=joined.sigma_m),
        *([replace(sample, method=DISAGREE)] if figures.disagreement else []),
    ]


def _seen(name: str, made: RenderedScene, lens: CameraModel) -> SeenTarget | None:
    finder = ours.detector(name, None, tolerance=f"{TOLERANCE_SHARE * SIZES_M[name]:.6f} m").detector
    frame = ours.framed(made)
    lens = lens.for_frame(frame)
    found = finder.detect(frame, lens=lens)
    measured = measure(found, finder.target_shape, lens, 0.0)
    if measured.distance_m is None or not _is_on(made.truth, found.centre_px):
        return None
    return SeenTarget(detection=found, measurement=measured, shape=finder.target_shape)


def _is_on(truth: Truth, centre_px: tuple[float, float]) -> bool:
    """Return whether what was found is the target, and not a thing of the clutter."""
    middle = truth.outline_px.mean(axis=0)
    return math.dist(middle, centre_px) < float(np.linalg.norm(truth.outline_px - middle, axis=1).max())
