"""What `check` says of rules comes true when they run: a rule that always loses its output never drives it for long."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from stadimeter.config.loader import Configuration, load_configuration
from support.observing import Rehearsal

FRAME_S = 0.1
LONGEST_S = 1.5
"""A second is what "for a moment only" means, and some frames until the filter has caught up with a jump."""
HEAD = """\
[camera]
driver = "simulated"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[world]
[targets.ball]
detector = "ideal"
[actuators.lamp]
driver = "simulated"
"""

ends = st.integers(1, 8).map(lambda half: half * 50)
limits = st.one_of(
    ends.map(lambda end: f'below = "{end} cm"'),
    ends.map(lambda end: f'above = "{end} cm"'),
    st.lists(ends, min_size=2, max_size=2, unique=True)
    .map(sorted)
    .map(lambda two: f'between = ["{two[0]} cm", "{two[1]} cm"]'),
)
conditions = st.one_of(
    st.builds(lambda limit, band: f'{{ {limit}, deadband = "{band} cm" }}', limits, st.sampled_from([0, 20, 120])),
    st.builds(lambda one, two: f"{{ any = [{{ {one} }}, {{ {two} }}] }}", limits, limits),
    st.builds(lambda one, two: f"{{ all = [{{ {one} }}, {{ not = {{ {two} }} }}] }}", limits, limits),
    st.just("{ seen = true }"),
)
rules = st.builds(
    lambda condition, off_delay, level: f'when = {condition}\noff_delay = "{off_delay} s"\nlevel = {level}\n',
    conditions,
    st.sampled_from([0, 1, 4]),
    st.sampled_from([0.3, 1.0]),
)
places = st.lists(st.tuples(st.integers(4, 50), st.integers(5, 40)), min_size=2, max_size=6)
"""Where the ball goes, in decimetres, and for how many frames it stands there."""


def way(stops: list[tuple[int, int]]) -> list[float]:
    """Return a distance for each frame: it stands, and goes on at 2 m/s."""
    distances_m: list[float] = []
    here = stops[0][0]
    for there, frames in stops:
        step = 2 if there > here else -2
        distances_m += [at / 10 for at in range(here, there, step)]
        distances_m += [there / 10] * frames
        here = there
    return distances_m


def longest_s(rehearsal: Rehearsal, rule: str) -> float:
    won = [decision.outputs[0].winner == rule for _, decision in rehearsal.decisions]
    return max((len(list(group)) * FRAME_S for is_won, group in groupby(won) if is_won), default=0.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("truth") / "rules.toml"


def loaded(file: Path, some: list[str]) -> Configuration | None:
    text = "".join(
        f'[rules.r{number}]\nactuator = "lamp"\npriority = {number}\n{rule}' for number, rule in enumerate(some)
    )
    file.write_text(HEAD + text, encoding="utf-8")
    try:
        return load_configuration(file)
    except ValueError:  # a condition that can never hold: refused
        return None


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(some=st.lists(rules, min_size=2, max_size=4), stops=places)
def test_a_rule_that_is_said_to_lose_always_never_drives_its_output_for_long(
    file: Path, some: list[str], stops: list[tuple[int, int]]
) -> None:
    configuration = loaded(file, some)
    if configuration is None:
        return
    losers = {warning.key.split(".")[1] for warning in configuration.warnings if warning.code == "shadowed"}
    event(f"{len(losers)} rules are said to lose")
    rehearsal = Rehearsal(configuration.plan, FRAME_S)
    if losers:
        rehearsal.see(*way(stops))
    for rule in losers:
        assert longest_s(rehearsal, rule) <= LONGEST_S, rule
