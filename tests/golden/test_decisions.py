"""Seeded recordings, written and replayed: what is decided in each of their cycles."""

from __future__ import annotations

import random
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.core.rule import AlarmRule
from stadimeter.workbench.replay import decisions, read_recording
from support.golden import Golden, digest
from support.random_scenes import RandomScene

RULES = Path(__file__).with_name("rules.toml")
RECORDINGS = 20
CYCLES = 75
RATES = (5, 10, 15, 30, 60)
WORDS_EVERY = 20
"""In so many cycles the reasons of all rules are put into words once: that takes longer than to decide."""


def test_twenty_recordings_are_decided_as_they_were(golden: Golden, tmp_path: Path) -> None:
    configuration = load_configuration(RULES)
    recordings, states = {}, defaultdict(list)
    raised: Counter[str] = Counter()
    for seed in range(RECORDINGS):
        parts: dict[str, list[Any]] = defaultdict(list)
        for number, decision in enumerate(_replayed(configuration, tmp_path / f"{seed}.jsonl", seed)):
            _take(parts, decision, has_words=number % WORDS_EVERY == 0)
            raised.update(event.source for event in decision.events if event.kind == "raised")
            for trace in decision.rules:
                states[trace.rule].append((trace.status, trace.active))
        recordings[f"recording {seed}"] = " ".join(f"{part} {digest(values)}" for part, values in parts.items())
    rules = {rule: f"raised {raised[rule]} times, {digest(values)}" for rule, values in states.items()}
    golden.compare("decisions", recordings | rules)


def _take(parts: dict[str, list[Any]], decision: Decision, *, has_words: bool) -> None:
    parts["commands"].append(decision.commands)
    parts["events"].append([(event.kind, event.source, event.at_s, event.notify) for event in decision.events])
    parts["rules"].append([(trace.rule, trace.status, trace.output) for trace in decision.rules])
    parts["outputs"].append([(trace.output, trace.winner, trace.losers) for trace in decision.outputs])
    parts["tracks"].append([(each.target, each.status, each.distance_m, each.sigma_m) for each in decision.tracks])
    parts["safety"].append((decision.safety, decision.safety_reason))
    parts["words"].append(decision.reasons if has_words else {})


def _replayed(configuration: Configuration, path: Path, seed: int) -> list[Decision]:
    """Write a recording of seeded observations, and return what a replay of it decides."""
    rng = random.Random(seed)  # noqa: S311 - the same recording each time
    names = tuple(rule.name for rule in configuration.plan.rules if isinstance(rule, AlarmRule))
    scene = RandomScene(rng, rng.choice(RATES), names, is_aimed=False)
    _, decision = decide(initial_state(configuration.plan), Observation(now_s=0.0))  # what was decided then is not read
    writer = JournalWriter(path, to_be_recorded(configuration))
    for observation in scene.observations(CYCLES):
        writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
    writer.close()
    return [decided for _, _, decided in decisions(read_recording(path), configuration.plan)]
