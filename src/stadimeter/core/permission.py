"""Whether an order could let an output act that would not act without it: what a sender needs to be trusted for."""

from __future__ import annotations

from stadimeter.core.conditions.compounds import depends_on
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, ReportRule, conditions_of, gate_of
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
    chosen = [each for each in plan.rules if rule in {"", each.name} and not isinstance(each, ReportRule)]
    return tuple(each.name for each in chosen if _could_let_act(plan, action, each))


def _could_let_act(plan: Plan, action: OperatorAction, rule: AnyRule) -> bool:
    reached = _dependents(plan, rule)
    if not any(map(_outputs, reached)):
        return False
    others = (each for each in plan.rules if each.name != rule.name)
    moves = {each.name for each in plan.outputs if isinstance(each, BaseOutput)}.union(*map(_outputs, others))
    is_alone = len(reached) == 1 and not moves.intersection(_outputs(rule))
    return not (action in _QUIETING and is_alone and _is_steady(rule))


def _dependents(plan: Plan, rule: AnyRule) -> list[AnyRule]:
    """Return a rule, and all whose conditions ask for it, or for one of those that do."""
    found, names = [rule], {rule.name}
    for known in found:
        for each in plan.rules:
            if each.name not in names and any(known.name in depends_on(condition) for condition in conditions_of(each)):
                names.add(each.name)
                found.append(each)
    return found


def _outputs(rule: AnyRule) -> set[str]:
    return {name for name in (rule.output, *(step.output for step in gate_of(rule).escalation)) if name is not None}


def _is_steady(rule: AnyRule) -> bool:
    """Return whether what it drives goes by its condition alone, and not by when and how it was raised or cleared."""
    if any(step.output is not None for step in gate_of(rule).escalation):
        return False
    return not isinstance(rule, AlarmRule) or (rule.pattern is None and rule.at_start == "act")
