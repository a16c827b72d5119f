"""A safety rule about speed stops for what is too fast, and hardly ever for what is not."""

import numpy as np
import pytest

SEED = 7


@pytest.mark.long
def test_a_target_below_the_limit_hardly_ever_stops_the_robot_and_a_fast_one_is_not_found_much_later():
    import closing_speeds
    from closing_speeds import BEFORE, DEFAULT

    plan, names = closing_speeds.rules()
    ball = closing_speeds.NOISES[1]
    after_s = {
        speed_mps: [
            closing_speeds.stops_after_s(plan, speed_mps, ball, np.random.default_rng([SEED, run]))
            for run in range(runs)
        ]
        for speed_mps, runs in ((0.7, 60), (2.0, 20))
    }
    rule_of = {what: name for name, what in names.items()}
    stopped = {what: sum(np.isfinite(each[rule_of[what]]) for each in after_s[0.7]) for what in rule_of}
    assert stopped[DEFAULT] <= 4 < stopped[BEFORE]
    late_s = {what: np.median([each[rule_of[what]] for each in after_s[2.0]]) for what in rule_of}
    assert late_s[DEFAULT] - late_s[BEFORE] < 0.1


def test_lateness_counts_from_the_moment_in_which_the_limit_is_passed():
    from closing_speeds import distances, late_s

    times_s = np.array([0.9, 1.1, 1.2, 1.4, 2.4])
    moved_m = 4.0 - distances(2.0, times_s, 1.0)
    assert np.allclose(moved_m, [0.0, 0.025, 0.1, 0.4, 2.4])
    assert np.allclose(late_s(np.array([0.1, 0.2, 0.5])), [0.0, 0.0, 0.3])
