"""What is remembered over windows of time: figures, and how often or how long other rules were active."""

import pytest
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.remembered import (
    SLOTS,
    RememberedCondition,
    RememberedFigure,
    Summary,
    Window,
    step_summary,
)
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.persistence import reload, restore_alarms, snapshot_alarms
from stadimeter.core.plan import Plan
from stadimeter.core.rule import ALWAYS, AlarmRule, EscalationStep, ReportRule, Send, Template
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.observing import measured

STEP_S = 0.1
NEAR = AlarmRule(
    name="near",
    target="ball",
    condition=DistanceCondition(below=1.0, probability_on=None, deadband_sigmas=0.0),
    off_delay_s=0.0,
    raises_per_min_max=0,
)
MINUTE, TODAY = Window(for_s=60.0), Window(from_second=0.0)
FIGURE = RememberedFigure(name="nearest", target="ball", window=MINUTE)
SEND = EscalationStep(send=Send(template=Template(text="{nearest}"), topic="report"))


def counting(above, unit="times", window=MINUTE):
    condition = RememberedCondition(rules=("near",), unit=unit, above=above, window=window)
    return AlarmRule(name="often", target="ball", condition=condition, off_delay_s=0.0)


class Run:
    """A run in which a ball is near or far, ten cycles a second."""

    def __init__(self, *rules, figures=(), clock=None, state=None):
        plan = Plan(targets=("ball",), rules=rules, figures=tuple(figures))
        self.state = state or initial_state(plan)
        self.clock, self.now_s, self.frames = clock, 100.0, 0
        self.notices, self.raised_s, self.decision = [], [], None

    def cycle(self, distance_m=None, *, step_s=STEP_S, command=None):
        self.now_s, self.frames = self.now_s + step_s, self.frames + 1
        if self.clock is not None:
            self.clock += step_s
        at_s = self.now_s - 0.01
        observation = Observation(
            now_s=self.now_s,
            frame=FrameStamp(sequence=self.frames, captured_at_s=at_s),
            measurements=() if distance_m is None else (measured("ball", at_s, distance_m, 0.0),),
            wall=None if self.clock is None else WallTime(second_of_day=self.clock % 86400, weekday=0),
            operator_commands=() if command is None else (command,),
        )
        self.state, self.decision = decide(self.state, observation)
        self.notices += self.decision.notices
        self.raised_s += [e.at_s for e in self.decision.events if e.source == "often" and e.kind == "raised"]

    def stay(self, distance_m, for_s):
        for _ in range(round(for_s / STEP_S)):
            self.cycle(distance_m)

    def visit(self, times=1):
        for _ in range(times):
            self.stay(0.5, 0.5)
            self.stay(2.0, 0.5)

    @property
    def is_often(self):
        return next(trace.active for trace in self.decision.rules if trace.rule == "often")


def reset(rule="often"):
    return OperatorCommand(id="1", action=OperatorAction.RESET, rule=rule, by="Ada")


# Counts and sums of other rules ----------------------------------------------------------------------------------


def test_a_rule_is_raised_when_another_was_raised_often_enough_within_a_minute_and_clears_when_it_was_not():
    run = Run(NEAR, counting(2.0))
    run.visit(2)
    assert not run.is_often
    run.visit()
    assert run.is_often
    run.stay(2.0, 56.5)
    assert run.is_often
    run.stay(2.0, 1.5)
    assert not run.is_often
    assert len(run.raised_s) == 1


def test_active_time_is_summed_up_and_leaves_the_window():
    run = Run(NEAR, counting(10.0, "s", Window(for_s=30.0)))
    run.stay(0.5, 6.0)
    run.stay(2.0, 10.0)
    run.stay(0.5, 3.8)
    assert not run.is_often
    run.stay(0.5, 0.6)
    assert run.is_often
    run.stay(2.0, 12.0)
    assert not run.is_often


def test_a_day_begins_at_midnight_and_nothing_of_it_is_known_without_the_time_of_day():
    unknown = Run(NEAR, counting(0.0, window=TODAY))
    unknown.visit(3)
    assert unknown.is_often is None
    run = Run(NEAR, counting(0.0, window=TODAY), clock=86400.0 - 3.0)
    run.visit()
    assert run.is_often
    run.stay(2.0, 3.0)
    assert not run.is_often


def test_a_clock_that_is_put_forward_by_an_hour_begins_no_other_day():
    run = Run(NEAR, counting(0.0, window=TODAY), clock=36000.0)
    run.visit()
    run.clock += 3600.0
    run.stay(2.0, 1.0)
    assert run.is_often


def test_a_reset_lets_a_rule_count_anew_and_one_of_all_rules_does_not():
    run = Run(NEAR, counting(1.0))
    run.visit(2)
    run.cycle(2.0, command=reset(""))
    run.cycle(2.0)
    assert run.is_often
    run.cycle(2.0, command=reset())
    assert [answer.accepted for answer in run.decision.answers] == [True]
    run.stay(2.0, 0.5)
    assert not run.is_often
    run.visit(2)
    assert run.is_often


def test_what_was_counted_survives_a_restart_and_time_off_counts_for_the_window():
    run = Run(NEAR, counting(2.0))
    run.visit(2)
    kept = snapshot_alarms(run.state)
    for off_s, expected in ((10.0, True), (70.0, False)):
        later = Run(NEAR, counting(2.0))
        later.now_s = 5000.0
        shift_s = 5000.0 - off_s - run.now_s
        from_s = 5000.0 - off_s
        later.state = restore_alarms(later.state, kept, shift_s=shift_s, from_s=from_s, now_s=5000.0)
        later.visit()
        assert later.is_often is expected


def test_an_alarm_that_goes_on_after_a_restart_is_not_counted_twice_and_time_off_is_no_active_time():
    rules = NEAR, counting(4.0, "s"), replace(counting(1.0), name="twice")
    run = Run(*rules)
    run.stay(0.5, 2.0)
    later = Run(*rules)
    later.state = restore_alarms(
        later.state, snapshot_alarms(run.state), shift_s=30.0, from_s=run.now_s + 30.0, now_s=run.now_s + 40.0
    )
    later.now_s = run.now_s + 40.0
    later.stay(0.5, 1.5)
    active = {trace.rule: trace.active for trace in later.decision.rules}
    assert active == {"near": True, "often": False, "twice": False}


def test_time_in_which_the_program_stood_still_is_no_active_time():
    run = Run(NEAR, counting(5.0, "s"))
    run.stay(0.5, 2.0)
    run.cycle(0.5, step_s=20.0)
    run.stay(0.5, 1.0)
    assert not run.is_often


def test_a_reload_keeps_what_was_counted_by_rules_that_stay_the_same():
    run = Run(NEAR, counting(1.0))
    run.visit()
    other = replace(NEAR, name="other")
    run.state = reload(run.state, Plan(targets=("ball",), rules=(other, counting(1.0), NEAR))).state
    run.visit()
    assert run.is_often


def test_memory_is_bounded_whatever_the_rate():
    figure = RememberedFigure(name="sum", rules=("near",), statistic="sum", window=MINUTE)
    kept = Summary()
    for number in range(8_000):
        kept = step_summary(figure, kept, 1.0, number * 0.01, None)
    assert len(kept.slots) <= SLOTS * 40 <= 10 * 1024
    assert kept.value == pytest.approx(6000, rel=1 / SLOTS)


# Figures -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statistic", "percentile", "expected"),
    [("minimum", 50.0, 1.0), ("maximum", 50.0, 5.0), ("mean", 50.0, 3.0), ("percentile", 50.0, 3.0),
     ("percentile", 90.0, 5.0), ("percentile", 0.0, 1.0), ("percentile", 100.0, 5.0)],
)  # fmt: skip
def test_statistics_of_few_values_are_exact(statistic, percentile, expected):
    figure = replace(FIGURE, statistic=statistic, percentile=percentile)
    kept = Summary()
    for number, value in enumerate((4.0, 2.0, 5.0, 1.0, 3.0)):
        kept = step_summary(figure, kept, value, 10.0 * number, None)
    assert kept.value == expected
    gone = step_summary(figure, kept, None, 200.0, None)
    assert gone.value is None
    assert gone.slots == b""


def test_a_percentile_of_many_values_is_right_to_the_width_of_a_slot():
    figure = replace(FIGURE, statistic="percentile", percentile=90.0)
    kept = Summary()
    for number in range(1800):  # 30 a second, from 0 m to 1.8 m within the minute
        kept = step_summary(figure, kept, number / 1000, number / 30, None)
    assert kept.value == pytest.approx(1.62, abs=0.01)


def test_a_rule_goes_by_the_nearest_of_the_last_minute_though_its_target_is_out_of_sight():
    rule = replace(counting(0.0), condition=RememberedCondition(name="nearest", below=0.6))
    run = Run(rule, figures=[FIGURE])
    run.stay(2.0, 1.0)
    assert run.is_often is False
    run.stay(0.5, 1.0)
    run.stay(None, 20.0)
    assert run.is_often
    run.stay(2.0, 50.0)
    assert run.is_often is False
    assert run.decision.figures["nearest"] == pytest.approx(2.0, abs=0.01)


def test_a_figure_is_unknown_without_a_value():
    rule = replace(counting(0.0), condition=RememberedCondition(name="nearest", below=0.6))
    run = Run(rule, figures=[FIGURE])
    run.stay(None, 1.0)
    assert run.is_often is None
    assert run.decision.reasons["often"].endswith("figure nearest is not known")


def test_figures_survive_a_restart_unless_they_mean_something_else():
    run = Run(figures=[FIGURE])
    run.stay(0.5, 1.0)
    kept = snapshot_alarms(run.state)
    same, other = Run(figures=[FIGURE]), Run(figures=[replace(FIGURE, statistic="maximum")])
    for later in (same, other):
        later.state = restore_alarms(later.state, kept, shift_s=5.0, from_s=106.0, now_s=106.0)
        later.now_s = 106.0
        later.stay(2.0, 1.0)
    assert same.decision.figures["nearest"] == pytest.approx(0.5, abs=0.01)
    assert other.decision.figures["nearest"] == pytest.approx(2.0, abs=0.01)


# Messages at times ---------------------------------------------------------------------------------------------------


def report(*, condition=ALWAYS, steps=(SEND,), **when):
    gate = AlarmRule(name="", target="", condition=condition, escalation=steps)
    return ReportRule(name="report", target="ball", gate=gate, **when)


def test_a_message_is_sent_every_so_often_and_a_missed_one_once():
    run = Run(report(every_s=5.0))
    run.stay(2.0, 16.0)
    assert [round(notice.event.at_s, 1) for notice in run.notices] == [105.1, 110.1, 115.1]
    run.cycle(2.0, step_s=22.0)
    run.stay(2.0, 3.0)
    assert [round(notice.event.at_s, 1) for notice in run.notices[3:]] == [138.0, 140.1]
    assert run.decision.events == ()


def test_a_message_at_a_time_of_day_is_sent_once_a_day_with_the_figures_of_the_day_before():
    run = Run(report(at_seconds=(0.0,)), figures=[replace(FIGURE, window=TODAY)], clock=86400.0 - 2.05)
    told = []
    for _ in range(100):
        run.cycle(0.5 if run.clock < 86400.0 - 0.1 else 2.0)
        told += [run.decision.figures["nearest"] for _ in run.decision.notices]
    assert [round(value, 2) for value in told] == [0.5]


@pytest.mark.parametrize(("late_s", "expected"), [(30.0, 1), (90.0, 0)])
def test_a_message_that_was_missed_is_sent_if_it_is_less_than_a_minute_late(late_s, expected):
    run = Run(report(at_seconds=(3600.0,)), clock=3590.0)
    run.cycle(2.0)
    run.cycle(2.0, step_s=10.0 + late_s)
    run.stay(2.0, 3.0)
    assert len(run.notices) == expected


def test_a_message_at_a_time_of_day_is_not_sent_again_after_a_restart_or_when_the_clock_is_put_back_a_little():
    run = Run(report(at_seconds=(3600.0,)), clock=3599.0)
    run.stay(2.0, 2.0)
    assert len(run.notices) == 1
    later = Run(report(at_seconds=(3600.0,)), clock=3610.0)
    later.now_s = 200.0
    later.state = restore_alarms(
        later.state, snapshot_alarms(run.state), shift_s=190.0 - run.now_s, from_s=190.0, now_s=200.0
    )
    later.stay(2.0, 2.0)
    later.clock = 3595.0
    later.stay(2.0, 65.0)
    assert later.notices == []


def test_a_message_is_sent_only_while_its_gate_is_open_and_not_later_and_where_that_is_unknown_it_is_sent():
    run = Run(report(every_s=1.0, condition=NEAR.condition))
    run.stay(2.0, 3.5)
    assert run.notices == []
    assert "does not hold" in run.decision.reasons["report"]
    run.stay(0.5, 1.0)
    assert [round(notice.event.at_s, 1) for notice in run.notices] == [104.1]
    assert run.notices[0].count == 1
    run.stay(None, 20.0)
    assert "cannot be known" in run.decision.reasons["report"]
    assert len(run.notices) > 15
