"""The additions of a cycle to what is remembered over windows of time; see `stadimeter.core.conditions.summary`."""

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
    """The things that are new in a cycle."""

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
            if figure.quantity == "times":
                is_raised = self.active is not self.was_active and _is_any(self.active, figure.rules)
                return 1.0 if is_raised and not _is_any(self.was_active, figure.rules) else None
            return self.step_s if self.step_s and _is_any(self.was_active, figure.rules) else None
        track = self.inputs.tracks.get(figure.target)
        if track is None or track.target not in self.seen or track.status is not TrackStatus.TRACKING:
            return None
        found = QUANTITIES[figure.quantity].read(self.inputs, figure.target)
        return None if found is None else found[0]


def _is_any(active: Mapping[str, bool | None], rules: tuple[str, ...]) -> bool:
    return True in [active.get(rule) for rule in rules]


def step_figures(
    figures: tuple[RememberedFigure, ...], before: tuple[Summary, ...], added: Added
) -> tuple[Summary, ...]:
    """Return the summaries of all figures after a cycle: a reset of a rule empties the sums that it goes by."""
    observation = added.observation
    commands = [each for each in observation.operator_commands if isinstance(each, OperatorCommand)]
    emptied = {each.rule for each in commands if each.action is OperatorAction.RESET and each.rule}
    kept = [Summary() if figure.owner in emptied else was for figure, was in zip(figures, before, strict=True)]
    pairs = zip(figures, kept, strict=True)
    return tuple([step_summary(it, was, added.to(it), observation.now_s, observation.wall) for it, was in pairs])
