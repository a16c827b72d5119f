"""Orders that could let an output act that would not act without them: what a sender needs to be trusted for."""

from __future__ import annotations

from stadimeter.core.conditions.compounds import depends_on
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, RampRule, conditions_of, gate_of
from stadimeter.operator_actions import OperatorAction

# They end what a rule does, and begin nothing.
_QUIETING = frozenset(
    {OperatorAction.ACKNOWLEDGE, OperatorAction.SHELVE, OperatorAction.TAKE_OUT, OperatorAction.OBSERVE}
)


def could_let_act(plan: Plan, action: OperatorAction, rule: str = "") -> tuple[str, ...]:
    """Return for which rules an order could let an output act; empty if it could not.

    An order may do so to a rule that drives an output, or on which such a rule depends: by beginning what the rule
    does, by ending what kept another from acting, or by letting a pattern begin anew. Only one that quiets a rule
    which alone drives its actuators, at a level that depends on nothing else, does not.

    Args:
        rule: The rule that the order is for; empty for every rule.
    """
    if action.is_on_outputs:
        return ("every output",) if action.lets_outputs_act else ()
    moving = _moving_rules(plan)
    chosen = (moving[each.name] for each in plan.rules if rule in {"", each.name} and each.name in moving)
    return tuple(each.name for each in chosen if not (action in _QUIETING and _is_quieted(plan, moving, each)))


def _moving_rules(plan: Plan) -> dict[str, AnyRule]:
    """Return the rules that drive an output, and those that they depend on, by name."""
    by_name = {rule.name: rule for rule in plan.rules}
    waiting = [rule for rule in plan.rules if _outputs(rule)]
    found: dict[str, AnyRule] = {}
    while waiting:
        rule = waiting.pop()
        if rule.name not in found:
            found[rule.name] = rule
            waiting += [by_name[name] for name in _asked_for(rule) if name in by_name]
    return found


def _is_quieted(plan: Plan, moving: dict[str, AnyRule], rule: AnyRule) -> bool:
    """Check whether to quiet a rule lets nothing act: it alone drives its actuators, and steadily."""
    others = [each for each in moving.values() if each.name != rule.name]
    moved = {each.name for each in plan.outputs if isinstance(each, BaseOutput)}.union(*map(_outputs, others))
    is_alone = moved.isdisjoint(_outputs(rule)) and not any(rule.name in _asked_for(each) for each in others)
    return is_alone and _is_steady(rule)


def _outputs(rule: AnyRule) -> set[str]:
    return {name for name in (rule.output, *(step.output for step in gate_of(rule).escalation)) if name is not None}


def _asked_for(rule: AnyRule) -> frozenset[str]:
    return frozenset().union(*map(depends_on, conditions_of(rule)))


def _is_steady(rule: AnyRule) -> bool:
    """Check whether what it drives goes by its condition alone, and not by when and how it was raised or cleared."""
    if any(step.output is not None for step in gate_of(rule).escalation):
        return False
    if isinstance(rule, RampRule):  # a level that is kept within a dead zone may be higher when it begins again
        return rule.dead_zone == 0.0
    return not isinstance(rule, AlarmRule) or (rule.pattern is None and rule.at_start == "act")
