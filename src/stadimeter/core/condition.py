"""Every kind of condition. Whether one holds is judged in `stadimeter.core.conditions.verdict`.

A condition holds, does not hold, or cannot be known. What is not known is never taken for either.
"""

from stadimeter.core.conditions.closing import ClosingCondition
from stadimeter.core.conditions.compounds import (
    AllOf,
    AnyOf,
    Condition,
    Not,
    about,
    depends_on,
    leaves,
    targets_of,
)
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.count import CountCondition
from stadimeter.core.conditions.direction import DirectionCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import Direction, Quantity
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.other_rule import RuleCondition
from stadimeter.core.conditions.presence import PresenceCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.separation import SeparationCondition

__all__ = [
    "AllOf",
    "AnyOf",
    "ClosingCondition",
    "Condition",
    "CountCondition",
    "Direction",
    "DirectionCondition",
    "DistanceCondition",
    "Leaf",
    "Not",
    "PresenceCondition",
    "Quantity",
    "RuleCondition",
    "ScheduleCondition",
    "SeparationCondition",
    "TimeToContactCondition",
    "about",
    "depends_on",
    "leaves",
    "targets_of",
]
