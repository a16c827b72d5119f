"""When a condition begins and when it ends, in plain words with figures. Each kind has its own; see `Leaf.begins`."""

from __future__ import annotations

from stadimeter.core.condition import AllOf, AnyOf, Condition, Leaf, Not, leaves


def begins(condition: Condition) -> str:
    r"""Return a clause such as ``\`ball\` is nearer than 0.50 m (1.6 ft) with a probability of 80%``."""
    match condition:
        case Leaf():
            return condition.begins()
        case Not():
            return f"not ({begins(condition.condition)})"
        case _:
            word = " and " if isinstance(condition, AllOf) else " or "
            return word.join(_inner(part) for part in condition.conditions)


def ends(condition: Condition) -> str:
    """Return a clause such as ``it is further than 0.50 m (1.6 ft) by 3 standard deviations of the noise``."""
    return condition.ends() if isinstance(condition, Leaf) else "that has ended"


def needs_figures(condition: Condition) -> bool:
    """Return whether a condition asks for a figure that is not known while its target is out of sight."""
    return any(leaf.has_figures for leaf in leaves(condition))


def _inner(condition: Condition) -> str:
    words = begins(condition)
    return f"({words})" if isinstance(condition, AllOf | AnyOf) else words
