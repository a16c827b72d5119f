"""Says in plain sentences what a configuration does, with the figures it works out to."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.draft import BASE_NAME
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.evidence import describe_begin, describe_end
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of
from stadimeter.core.conditions.remembered import RememberedFigure
from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.core.rule import (
    ALWAYS,
    AlarmRule,
    AnyRule,
    EscalationStep,
    FollowRule,
    LostPolicy,
    OnDelay,
    Pattern,
    RampRule,
    ReportRule,
)
from stadimeter.core.rules.ramp import when_in_words
from stadimeter.core.words import duration, figure_in_words, length


def describe(configuration: Configuration) -> tuple[str, ...]:
    """Say what a configuration does.

    Returns:
        One sentence or two for what it looks through and for each rule, in the order of the file. Names of parts
        stand between backticks.
    """
    rules = [_rule(rule, configuration) for rule in configuration.plan.rules]
    figures = [_figure(figure) for figure in configuration.plan.named_figures]
    return (*_parts(configuration), *figures, *rules)


def _parts(configuration: Configuration) -> Iterator[str]:
    lens = f" through a lens of {_lens(configuration.camera_model)}" if configuration.camera_model else ""
    targets = " and ".join(f"`{target.name}` ({_kind(target)})" for target in configuration.targets)
    yield f"Looks for {targets} with the camera driver {configuration.camera.driver}{lens}{_beside(configuration)}."
    if configuration.messenger:
        yield f"Sends messages with {configuration.messenger.driver}."
    for notifier in configuration.notifiers:
        yield f"Tells people through `{notifier.name}` ({notifier.driver})."
    if configuration.status_led:
        yield f"Shows how it is doing on `{configuration.status_led.name}` ({configuration.status_led.driver})."
    if configuration.web is not None:
        yield f"Its page for browsers is at port {configuration.web.port}."
    if configuration.black_box is not None:
        yield configuration.black_box.describe()
    for button, table in configuration.button_tables.items():
        held = f"; held for {duration(table.hold_for)}: {table.hold}" if table.hold else ""
        whom = f"`{table.rule}`" if table.rule else "all"
        yield f"The button `{button}` is for {whom}; pressed: {table.press}{held}."


def _beside(configuration: Configuration) -> str:
    second, rig = configuration.second_camera, configuration.rig
    return f", and from {length(rig.baseline_m)} beside it with {second.driver}" if second and rig else ""


def _kind(target: DriverChoice) -> str:
    return f"{len(target.members)} × {target.driver}" if target.options.members else target.driver


def _figure(figure: RememberedFigure) -> str:
    what = f"percentile {figure.percentile:g}" if figure.statistic == "percentile" else figure.statistic
    of = f"{figure.quantity.replace('_', ' ')} of `{figure.target}` {figure.window}"
    return f"Remembers `{figure.name}`: the {'median' if what == 'percentile 50' else what} of the {of}."


def _lens(model: CameraModel) -> str:
    width_deg = math.degrees(2 * math.atan(model.width_px / 2 / model.fx_px))
    return f"{model.fx_px:.0f} px focal length, {width_deg:.0f}° wide at {model.width_px}x{model.height_px}"


def _rule(rule: AnyRule, configuration: Configuration) -> str:
    match rule:
        case AlarmRule():
            does = _alarm(rule, configuration)
        case RampRule():
            does = _ramp(rule, configuration)
        case ReportRule():
            steps = rule.gate.escalation
            does = f"{' and '.join(_report(step, configuration) for step in steps)} {when_in_words(rule)}."
        case _:
            does = _follow(rule, configuration)
    return f"`{rule.name}` {does}{_gate(rule)}{_wins(rule, configuration)}"


def _report(step: EscalationStep, configuration: Configuration) -> str:
    only_if = f" if {describe_begin(step.when)}" if step.when is not None else ""
    return f"{_does(step, configuration)}{only_if}"


def _gate(rule: AnyRule) -> str:
    """Say when a rule that has a gate does not act."""
    if isinstance(rule, AlarmRule):
        return ""
    gate, acts = rule.gate, "Sends" if isinstance(rule, ReportRule) else "Acts"
    only = f" {acts} only while {describe_begin(gate.condition)}." if gate.condition is not ALWAYS else ""
    quiet = f" Keeps quiet while {describe_begin(gate.suppress_when)}." if gate.suppress_when is not None else ""
    return only + quiet


def _alarm(rule: AlarmRule, configuration: Configuration) -> str:
    condition = f"{_acts(rule, configuration)} when {describe_begin(rule.condition)}{_delay(rule.on_delay)}"
    besides = "".join(f" {sentence}." for sentence in _sentences(rule, configuration))
    return f"{condition}; clears {_ends(rule)}.{_lost_alarm(rule)}{besides}"


def _acts(rule: AlarmRule, configuration: Configuration) -> str:
    if rule.output is None:
        return f"gives the alert ({rule.severity})"
    verb = _verb(rule.output, configuration)
    if verb == "stops":
        return f"stops `{rule.output}`"
    level = "" if rule.level == 1 or rule.pattern is not None else f" at {rule.level:.0%}"
    return f"{verb} `{rule.output}`{level}{_rhythm(rule.pattern)}"


def _verb(output: str, configuration: Configuration) -> str:
    """Return the verb for an output that acts, such as ``lights``; a rule with a condition stops a base."""
    if configuration.base is not None and output == BASE_NAME:
        return "stops"
    return next((each.options.verb for each in configuration.actuators if each.name == output), "drives")


def _delay(delay: OnDelay) -> str:
    if delay.frames:
        return f" in {delay.frames} of {delay.of_frames} frames"
    return f" for {duration(delay.hold_s)}" if delay.hold_s else ""


def _ends(rule: AlarmRule) -> str:
    held = f"for {duration(rule.off_delay_s)}" if rule.off_delay_s else "at once"
    return f"when {describe_end(rule.condition)} {held}"


def _lost_alarm(rule: AlarmRule) -> str:
    lost = rule.lost
    if not any(leaf.has_figures for leaf in leaves(rule.condition)):  # none that is not known out of sight
        return ""
    held = f" for {duration(lost.fault_after_s)}, then goes safe" if rule.output else " until it is seen again"
    match lost.policy:
        case LostPolicy.HOLD:
            return f" If lost, it holds{held if not rule.latch else ''}."
        case LostPolicy.CLEAR:
            later = f" {duration(rule.off_delay_s)} later" if rule.off_delay_s else ""
            return f" If lost for {duration(lost.grace_s)}, it clears{later}."
        case _:
            return f" If lost for {duration(lost.grace_s)}, it is raised: not seeing counts as danger."


def _wins(rule: AnyRule, configuration: Configuration) -> str:
    rivals = (each for each in configuration.plan.rules if each.output == rule.output is not None)
    losers = [f"`{each.name}`" for each in rivals if each.priority < rule.priority]
    return f" Goes before {' and '.join(losers)}." if losers else ""


def _ramp(rule: RampRule, configuration: Configuration) -> str:
    output = rule.output or ""
    return f"{_verb(output, configuration)} `{output}` {_strength(rule)}; {_safe(output, configuration)} when lost."


def _safe(output: str, configuration: Configuration) -> str:
    levels = {each.name: each.safe_level for each in configuration.plan.outputs if isinstance(each, LevelOutput)}
    level = levels.get(output, 0.0)
    return f"at {level:.0%}" if level else "off"


def _follow(rule: FollowRule, configuration: Configuration) -> str:
    base = next((each for each in configuration.plan.outputs if isinstance(each, BaseOutput)), None)
    most_mps = min(rule.linear_max_mps, base.linear_max_mps) if base else rule.linear_max_mps
    reverse = f"up to {rule.reverse_max_mps:g} m/s backwards" if rule.reverse_max_mps else "never backwards"
    if most_mps or rule.reverse_max_mps:
        does = (
            f"{length(rule.distance_m)} from `{rule.target}` and turned towards it, up to {most_mps:g} m/s forwards, "
        )
        does += reverse
    else:
        does = f"turned{' and tilted' if base and base.tilts else ''} towards `{rule.target}`, without driving"
    return f"keeps `{rule.output}` {does}{_bounds(rule)}; stops when lost{_searching(rule)}."


def _bounds(rule: FollowRule) -> str:
    tether = f", no further than {length(rule.tether_m)} from where it began" if rule.tether_m is not None else ""
    return f"{tether}, slowly near `{rule.slow.target}`" if rule.slow is not None else tether


def _searching(rule: FollowRule) -> str:
    return (
        ""
        if rule.search is None
        else f", then turns in steps to look for it, for {duration(rule.search.for_s)} at most"
    )


def _strength(rule: RampRule) -> str:
    """Say where a ramp acts, such as ``when `ball` is further than 3.05 m (10.0 ft), full at 6.10 m (20.0 ft)``."""
    along = " along the optical axis" if rule.quantity == "depth" else ""
    dead_zone = f", and not at all below {rule.dead_zone:.0%}" if rule.dead_zone else ""
    unit = QUANTITIES[rule.quantity].unit
    noun = "distance" if rule.quantity == "depth" else noun_of(rule.quantity)
    if rule.points:
        points = ", ".join(f"{_full(level)} at {figure_in_words(at, unit)}" for at, level in rule.points)
        return f"by the {noun} of `{rule.target}`{along}: {points}{dead_zone}"
    grows = rule.full > rule.start
    subject = f"`{rule.target}` is {'further' if grows else 'nearer'} than"
    if noun != "distance":
        subject = f"the {noun} of `{rule.target}` is {'above' if grows else 'below'}"
    least = f"at least {rule.level_min:.0%}, " if rule.level_min else ""
    return (
        f"when {subject} {figure_in_words(rule.start, unit)}{along}, "
        f"{least}{_full(rule.level_max)} at {figure_in_words(rule.full, unit)}{dead_zone}"
    )


def _full(level: float) -> str:
    return {0.0: "off", 1.0: "full"}.get(level, f"{level:.0%}")


def _rhythm(pattern: Pattern | None) -> str:
    """Say how a level changes by itself, such as `` in turns of 100% for 0.2 s and 0% for 0.3 s, 3 times``."""
    if pattern is None:
        return ""
    turns = " and ".join(f"{level:.0%} for {duration(for_s)}" for level, for_s in pattern.steps)
    return f" in turns of {turns}" + (f", {pattern.times} times" if pattern.times else "")


def _sentences(rule: AlarmRule, configuration: Configuration) -> Iterator[str]:
    """Say what an alarm does besides, and what becomes of it."""
    if rule.observe:
        yield "Is only observed: it drives nothing and sends nothing"
    for step in rule.escalation:
        yield _step(step, configuration)
    if rule.latch:
        yield f"Latches: stands until {_unlatched(rule)}"
    if rule.ack == "required" and not rule.ack_resets:
        yield "Must be acknowledged"
    if rule.realarm_s is not None:
        yield f"Is reported again every {duration(rule.realarm_s)} while it stands"
    if rule.suppress_when is not None:
        yield f"Keeps quiet while {describe_begin(rule.suppress_when)}"


def _unlatched(rule: AlarmRule) -> str:
    if rule.ack_resets:
        return f"`stadimeter alarm ack {rule.name}`"
    return f"`stadimeter alarm reset {rule.name}`{', after an acknowledgement' if rule.ack == 'required' else ''}"


def _step(step: EscalationStep, configuration: Configuration) -> str:
    when = "When it clears" if step.on == "cleared" else "When raised"
    after = f", {duration(step.after_s)} later" if step.after_s else ""
    unless = " unless it has been acknowledged" if step.only_unacknowledged else ""
    only_if = f" if {describe_begin(step.when)}" if step.when is not None else ""
    return f"{when}{after} {_does(step, configuration)}{unless}{only_if}"


def _does(step: EscalationStep, configuration: Configuration) -> str:
    if step.output is not None:
        level = "" if step.level == 1 or step.pattern is not None else f" at {step.level:.0%}"
        lasting = "" if math.isinf(step.for_s) else f" for {duration(step.for_s)}"
        return f"{_verb(step.output, configuration)} `{step.output}`{level}{_rhythm(step.pattern)}{lasting}"
    if step.send is not None and step.send.notifier:
        return f"notifies `{step.send.notifier}`"
    return f"sends `{step.send.topic}`" if step.send is not None else "does nothing"
