"""Looking for a target that a base has lost: it turns in place, in steps, to the side where the target was last.

::

    wait ──hidden_s──▶ turn ──a step──▶ look ──look_s──▶ turn … ──angle or time used up──▶ ended
    (only if it was lost in the middle of the view)

A base that spins shows a ball for seven or eight frames only, and blurred. So it stands between two steps, for as long
as a target takes to be confirmed. It never drives: the camera does not see what is beside the base. A camera that tilts
stays tilted as it was when it lost its target.
"""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.rule import Search

# A target nearer than this to the middle of the view was hidden by something; it cannot have left a camera's view,
# which is 40° wide at least.
HIDDEN_RAD = math.radians(15)

# The first turn goes to where the target may be by now, but no further than this: most of what a camera sees.
MAX_FIRST_STEP_RAD = math.radians(45)

# It has turned when it is this near to where it shall be.
ARRIVED_RAD = math.radians(3)

# A base that does not get there in this many times the usual time is hindered: it looks where it is.
HINDERED_TIMES, HINDERED_S = 2.0, 0.5


class SearchStep(Struct, frozen=True, kw_only=True):
    """Where a search is.

    Attributes:
        side: 1 for turning to the left, −1 to the right.
        goal_rad: The heading that it turns to.
        turned_rad: How far it will have turned then.
        phase_s: For how long the phase has lasted.
        spent_s: For how long it has searched; time in which outputs may not act does not count.
    """

    phase: Literal["wait", "turn", "look", "ended"]
    side: int
    goal_rad: float
    turned_rad: float = 0.0
    phase_s: float = 0.0
    spent_s: float = 0.0


def begin_search(settings: Search, heading_rad: float, bearing_rad: float) -> SearchStep:
    """Begin to look for a target.

    Args:
        heading_rad: Where the base points, counter-clockwise.
        bearing_rad: Where the target must be by now as it moved, positive to the right.
    """
    side = -1 if bearing_rad > 0 else 1
    if abs(bearing_rad) < HIDDEN_RAD:
        return SearchStep(phase="wait", side=side, goal_rad=heading_rad)
    first_rad = min(max(abs(bearing_rad), settings.step_rad), MAX_FIRST_STEP_RAD, settings.angle_rad)
    return SearchStep(phase="turn", side=side, goal_rad=heading_rad + side * first_rad, turned_rad=first_rad)


def step_search(
    search: SearchStep, settings: Search, heading_rad: float, will_be_rad: float, for_s: float
) -> tuple[SearchStep, float]:
    """Go on searching; return the search and the rate of turn in rad/s, positive to the left.

    Args:
        heading_rad: Where the base points.
        will_be_rad: Where it will point if it is stopped now: wheels run on for a moment.
        for_s: Since the cycle before.
    """
    search = replace(search, phase_s=search.phase_s + for_s, spent_s=search.spent_s + for_s)
    if search.phase != "ended" and search.spent_s > settings.for_s:
        search = replace(search, phase="ended")
    if search.phase == "turn" and not _is_there(search, settings, will_be_rad):
        return search, search.side * settings.rate_radps
    if search.phase == "turn":
        search = replace(search, phase="look", phase_s=0.0)
    wait_s = settings.hidden_s if search.phase == "wait" else settings.look_s
    if search.phase in {"wait", "look"} and search.phase_s >= wait_s:
        return _next_turn(search, settings, heading_rad), 0.0
    return search, 0.0


def _is_there(search: SearchStep, settings: Search, will_be_rad: float) -> bool:
    left_rad = search.side * (search.goal_rad - will_be_rad)
    usual_s = MAX_FIRST_STEP_RAD / settings.rate_radps
    return left_rad <= ARRIVED_RAD or search.phase_s > HINDERED_TIMES * usual_s + HINDERED_S


def _next_turn(search: SearchStep, settings: Search, heading_rad: float) -> SearchStep:
    step_rad = min(settings.step_rad, settings.angle_rad - search.turned_rad)
    if step_rad <= ARRIVED_RAD:
        return replace(search, phase="ended", phase_s=0.0)
    return replace(
        search,
        phase="turn",
        phase_s=0.0,
        goal_rad=heading_rad + search.side * step_rad,
        turned_rad=search.turned_rad + step_rad,
    )
