from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.simulation.motion import Ball, WayPoint

metres = st.floats(-10, 10).map(lambda value: round(value, 3))


def point(at_s: float, x_m: float, y_m: float = 0.0) -> WayPoint:
    return WayPoint.model_validate({"at": f"{at_s} s", "x": f"{x_m} m", "y": f"{y_m} m"})


def ball_on(*path: WayPoint, loop: bool = False, start_s: float = 0.0) -> Ball:
    return Ball(diameter_m=0.2, height_m=0.1, path=path, loop=loop, start_s=start_s)


def test_a_ball_with_one_way_point_lies_there() -> None:
    ball = ball_on(point(0, 2, -1), loop=True)
    assert [ball.position_m(time_s) for time_s in (-5.0, 0.0, 3.0, 1e6)] == [(2.0, -1.0, 0.1)] * 4


def test_a_ball_is_at_its_way_points_in_time() -> None:
    ball = ball_on(point(0, 2), point(3, 5, 1), point(4, 1, -2), start_s=100.0)
    assert ball.position_m(100.0) == pytest.approx((2, 0, 0.1))
    assert ball.position_m(103.0) == pytest.approx((5, 1, 0.1))
    assert ball.position_m(104.0) == pytest.approx((1, -2, 0.1))


def test_without_a_loop_the_ball_stays_at_the_end() -> None:
    ball = ball_on(point(0, 2), point(3, 5))
    assert ball.position_m(1000.0) == (5.0, 0.0, 0.1)


def test_with_a_loop_the_ball_begins_again() -> None:
    ball = ball_on(point(0, 2), point(3, 5), point(5, 2), loop=True)
    assert ball.position_m(5 * 7 + 1.2) == pytest.approx(ball.position_m(1.2))


def test_the_speed_never_jumps() -> None:
    ball = ball_on(point(0, 1), point(2, 3), point(3, 3.5), point(6, 9), point(9, 1), loop=True)
    step_s = 1e-3
    xs = [ball.position_m(number * step_s)[0] for number in range(18000)]
    speeds = [(after - before) / step_s for before, after in pairwise(xs)]
    changes = [abs(after - before) for before, after in pairwise(speeds)]
    assert max(changes) < 20 * step_s


@given(
    xs=st.lists(metres, min_size=2, max_size=6),
    gaps=st.lists(st.integers(1, 50), min_size=6, max_size=6),
    share=st.floats(0, 1),
    loop=st.booleans(),
)
def test_a_ball_stays_between_its_way_points(xs: list[float], gaps: list[int], share: float, loop: bool) -> None:
    xs = [*xs, xs[0]] if loop else xs
    times_s = [sum(gaps[:index]) / 10 for index in range(len(xs))]
    ball = ball_on(*(point(time_s, x_m) for time_s, x_m in zip(times_s, xs, strict=True)), loop=loop)
    at_s = share * times_s[-1]
    leg = next(index for index in range(len(xs) - 1) if at_s <= times_s[index + 1])
    low, high = sorted(xs[leg : leg + 2])
    assert low - 1e-9 <= ball.position_m(at_s)[0] <= high + 1e-9
