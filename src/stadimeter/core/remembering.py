"""What a cycle adds to what is remembered over windows of time; see `stadimeter.core.conditions.summary`."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import NamedTuple

from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.summary import RememberedFigure, Summary, step_summary
from stadimeter.core.observation import Observation
from stadimeter.core.operator import OperatorCommand
from stadimeter.core.track import TrackStatus
from stadimeter.operator_actions import OperatorAction


class Added(NamedTuple):
    """What is new in a cycle."""

    inputs: RuleInputs
    """What the rules were judged by."""
    seen: Container[str]
    """The targets that were measured in the frame that is new."""
    was_active: Mapping[str, bool | None]
    """Which rules were active after the cycle before."""
    active: Mapping[str, bool | None]
    step_s: float
    """The time since the cycle before; 0 if it was not observed."""
    observation: Observation

    def to(self, figure: RememberedFigure) -> float | None:
        """Return the new value of a figure; None for none."""
        if figure.rules:
            was, now = [any(each.get(it) is True for it in figure.rules) for each in (self.was_active, self.active)]
            if figure.quantity == "times":
                return 1.0 if now and not was else None
            return self.step_s if was and self.step_s else None
        track = self.inputs.tracks.get(figure.target)
        if track is None or track.target not in self.seen or track.status is not TrackStatus.TRACKING:
            return None
        found = QUANTITIES[figure.quantity].read(self.inputs, figure.target)
        return None if found is None else found[0]


def step_figures(
    figures: tuple[RememberedFigure, ...], before: tuple[Summary, ...], added: Added
) -> tuple[Summary, ...]:
    """Return what is kept of all figures after a cycle: a reset of a rule empties the sums that it goes by."""
    if not figures:
        return ()
    observation = added.observation
    commands = [each for each in observation.operator_commands if isinstance(each, OperatorCommand)]
    emptied = {each.rule for each in commands if each.action is OperatorAction.RESET and each.rule}
    kept = [Summary() if figure.owner in emptied else was for figure, was in zip(figures, before, strict=True)]
    pairs = zip(figures, kept, strict=True)
    return tuple([step_summary(it, was, added.to(it), observation.now_s, observation.wall) for it, was in pairs])
