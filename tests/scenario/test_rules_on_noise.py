"""Rules with the defaults that a user gets, judged on noise: hardly ever raised for nothing, and not late.

The noise is that of a box around an object: 15 frames a second, an object of 0.5 m, a focal length of 1000 px, an error
of 3 px (one standard deviation) of the box's height that is correlated from frame to frame by 0.6. That is 0.024 m at
2 m and 0.384 m at 8 m. In 1 frame of 100 the height is grossly wrong, by 30 % up to a factor of 3; 5 of 100 frames have
no box at all.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind
from stadimeter.core.observation import FrameStamp, Observation
from support.observing import measured, missed
from support.scenes.draw import REPORT_SEEDS

pytestmark = pytest.mark.long

FRAMES_PER_S = 15.0
OBJECT_M, FOCAL_PX = 0.5, 1000.0
NOISE_PX, CORRELATION = 3.0, 0.6
OUTLIERS, DROPOUTS = 0.01, 0.05
GROSS_FACTORS = (1.3, 3.0)
SMALLEST_BOX_PX = 2.0

CONFIGURATION = """
[camera]
driver = "simulated"

[camera.model]
width_px = 640
height_px = 480
fx_px = 1000.0

[targets.object]
detector = "ideal"

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""


def plan_of(tmp_path, **rules):
    path = tmp_path / "rules.toml"
    path.write_text(CONFIGURATION + "".join(f"[rules.{name}]\n{text}\n" for name, text in rules.items()))
    return load_configuration(path).plan


def sigma_m(distance_m):
    """Return the standard deviation of a measured distance: that of the box, scaled."""
    return distance_m**2 * NOISE_PX / (FOCAL_PX * OBJECT_M)


def correlated(count, random):
    """Return noise of unit variance that keeps `CORRELATION` of itself from frame to frame."""
    fresh = random.normal(size=count)
    fresh[1:] *= math.sqrt(1 - CORRELATION**2)
    noise, last = np.empty(count), 0.0
    for index, each in enumerate(fresh):
        last = noise[index] = CORRELATION * last + each
    return noise


def seen_m(true_m, random):
    """Return what is measured of true distances, a frame each; NaN where there is no box."""
    box_px = FOCAL_PX * OBJECT_M / true_m + NOISE_PX * correlated(len(true_m), random)
    least, most = np.log(GROSS_FACTORS)
    wrong_by = np.exp(random.uniform(least, most, len(true_m)) * random.choice((-1.0, 1.0), len(true_m)))
    box_px = np.where(random.random(len(true_m)) < OUTLIERS, box_px * wrong_by, box_px)
    measured_m = FOCAL_PX * OBJECT_M / np.maximum(box_px, SMALLEST_BOX_PX)
    return np.where(random.random(len(true_m)) < DROPOUTS, np.nan, measured_m)


def turns(plan, times_s, distances_m, sigmas_m):
    """Run the core over measured distances; return when each rule was raised or cleared, and which of the two."""
    state, found = initial_state(plan), {rule.name: [] for rule in plan.rules}
    rows = zip(times_s.tolist(), distances_m.tolist(), sigmas_m.tolist(), strict=True)
    for number, (at_s, distance_m, each_sigma_m) in enumerate(rows):
        is_missed = math.isnan(distance_m)
        sight = missed("object", at_s) if is_missed else measured("object", at_s, distance_m, each_sigma_m)
        stamp = FrameStamp(sequence=number, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=stamp, measurements=(sight,)))
        for event in decision.events:
            if event.kind in {EventKind.RAISED, EventKind.CLEARED}:
                found[event.source].append((at_s, event.kind is EventKind.RAISED))
    return found


def late_s(turned, crossed_at_s):
    """Return how long after the object crossed the threshold the alarm stood; infinite if it never did."""
    is_active = False
    for at_s, is_raise in turned:
        if at_s >= crossed_at_s and (is_active or is_raise):
            return 0.0 if is_active else at_s - crossed_at_s
        is_active = is_raise
    return 0.0 if is_active else math.inf


@pytest.mark.timeout(400)
@pytest.mark.parametrize("limit_m", [2.0, 8.0])
def test_an_alarm_as_it_comes_does_not_flap_is_hardly_raised_for_nothing_and_is_not_late(limit_m, tmp_path):
    """It hovers at the limit, stands three standard deviations behind it, and comes at 2 m/s ten times; 40 runs."""
    when = f'when = {{ below = "{limit_m} m" }}'
    plan = plan_of(tmp_path, plain=when, strict=f'severity = "safety"\n{when}')
    a_minute_s = np.arange(1, round(60 * FRAMES_PER_S) + 1) / FRAMES_PER_S
    hovering, behind, late = ({"plain": [], "strict": []} for _ in range(3))

    def judge(true_m, times_s, random):
        distances_m = seen_m(true_m, random)
        return turns(plan, times_s, distances_m, sigma_m(distances_m)).items()

    for run in range(40):
        random = np.random.default_rng([REPORT_SEEDS.start, round(limit_m), run])
        for name, turned in judge(np.full(len(a_minute_s), limit_m), a_minute_s, random):
            hovering[name].append(len(turned))
        for name, turned in judge(np.full(len(a_minute_s), limit_m + 3 * sigma_m(limit_m)), a_minute_s, random):
            behind[name].append(sum(is_raise for _, is_raise in turned))
        for _ in range(10):
            times_s = (random.random() + np.arange(round(5 * FRAMES_PER_S))) / FRAMES_PER_S
            for name, turned in judge(np.maximum(limit_m - 2.0 * (times_s - 3.0), 0.3), times_s, random):
                late[name].append(late_s(turned, 3.0))
    assert np.mean(behind["plain"]) <= 0.05
    for name in ("plain", "strict"):
        assert np.mean(hovering[name]) <= 1.0
        assert np.mean(late[name]) <= 0.11


def test_a_target_below_the_limit_hardly_ever_stops_the_robot_and_a_fast_one_is_not_found_much_later(tmp_path):
    """A safety rule about speed: a ball with noise of 0.5 % at 30 Hz rests at 4 m, then comes at a steady speed."""
    speed = 'severity = "safety"\nwhen = { closing_speed = { above = "1 m/s"%s } }'
    plan = plan_of(tmp_path, even_odds=speed % ", probability = 0.5", as_it_comes=speed % "")

    def raised_s(speed_mps, run):
        random = np.random.default_rng([7, run])
        sets_off_s = 2.0 + random.random()
        times_s = np.arange(1, round((sets_off_s + 3.5 / speed_mps) * 30)) / 30
        gone_s, speeds_up_s = np.maximum(0.0, times_s - sets_off_s), speed_mps / 5.0
        way_m = np.where(gone_s < speeds_up_s, 2.5 * gone_s**2, speed_mps * (gone_s - speeds_up_s / 2))
        sigmas_m = 0.005 * (4.0 - way_m) ** 2 / 4.0
        found = turns(plan, times_s, 4.0 - way_m + sigmas_m * random.normal(size=len(times_s)), sigmas_m)
        return {name: turned[0][0] - sets_off_s if turned else math.inf for name, turned in found.items()}

    slow, fast = ([raised_s(speed_mps, run) for run in range(runs)] for speed_mps, runs in ((0.7, 60), (2.0, 20)))
    stopped = {name: sum(math.isfinite(each[name]) for each in slow) for name in slow[0]}
    assert stopped["as_it_comes"] <= 4 < stopped["even_odds"]
    found_s = {name: np.median([each[name] for each in fast]) for name in fast[0]}
    assert found_s["as_it_comes"] - found_s["even_odds"] < 0.1
