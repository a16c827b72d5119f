"""How well a base follows, through the whole program: one with lagging wheels, and one that obeys at once."""

import tomllib
from pathlib import Path

import pytest

from support.following import (
    follow,
    is_within_limits,
    out_of_sight_s,
    random_walk,
    rms,
    stands,
    swaying_path,
    sways,
    walks_away,
)

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(params=["emulated", "ideal"])
def base(request):
    return request.param


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_a_step_of_half_a_metre_is_settled_within_2_5_s_and_standing_stays_within_two_per_cent(
    base, latency_ms, tmp_path
):
    moments = follow(tmp_path, 12, stands(1.5), base=base, latency_ms=latency_ms)
    assert max((each.at_s for each in moments if abs(each.gap_m - 1) > 0.1), default=0.0) <= 2.5
    assert min(each.gap_m for each in moments) >= 0.95
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 6]) <= 0.02
    assert is_within_limits(moments)


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_behind_a_ball_that_walks_away_it_stays_within_5_cm(base, latency_ms, tmp_path):
    moments = follow(tmp_path, 12, walks_away, base=base, latency_ms=latency_ms)
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 5]) <= 0.05


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_a_ball_that_goes_to_and_fro_and_sways_is_kept_within_10_cm_and_never_at_half_the_distance(
    base, latency_ms, tmp_path
):
    moments = follow(tmp_path, 35, sways, base=base, latency_ms=latency_ms)
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 5]) <= {30: 0.10, 190: 0.11}[latency_ms]
    assert min(each.gap_m for each in moments) > 0.5
    assert is_within_limits(moments)


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_the_follow_ball_configuration_stays_further_than_half_the_distance_from_a_ball_at_half_a_metre_a_second(
    latency_ms, tmp_path
):
    shipped = tomllib.loads((REPOSITORY / "config" / "follow-ball.toml").read_text())
    table = shipped["rules"]["follow"]["follow"]
    keys = ", ".join(f'{key} = "{value}"' for key, value in table.items())
    for path in (sways, swaying_path(1), swaying_path(2)):
        moments = follow(tmp_path, 35, path, latency_ms=latency_ms, rule=keys, most=shipped["base"]["max_speed"])
        assert min(each.gap_m for each in moments) > 0.5


@pytest.mark.long
def test_a_ball_that_is_hidden_for_a_second_is_followed_again_within_1_5_s(base, tmp_path):
    moments = follow(tmp_path, 8, walks_away, base=base, hidden=lambda at_s: 4 <= at_s < 5)
    (span_s,) = out_of_sight_s(moments)
    assert span_s <= 1.5
    assert abs(moments[-1].gap_m - 1) < 0.1


@pytest.mark.long
def test_a_ball_that_leaves_the_view_is_found_within_8_s(base, tmp_path):
    moments = follow(tmp_path, 14, lambda at_s: (1.0, 0.0) if at_s < 2 else (-0.6, 0.8), base=base)
    (span_s,) = out_of_sight_s(moments)
    assert span_s <= 8.0
    assert any("search_begun" in each.events for each in moments)


@pytest.mark.long
def test_on_random_walks_it_runs_into_nothing_and_finds_its_ball_again(base, tmp_path):
    for seed in (101, 102):
        moments = follow(tmp_path, 60, random_walk(seed, 60), base=base)
        assert min(each.gap_m for each in moments) > 0.5
        assert is_within_limits(moments)
        assert all(span_s <= 8.0 for span_s in out_of_sight_s(moments))
