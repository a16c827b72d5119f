"""The metrics of a run in the text format of Prometheus."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.registry import Collector

# Of `app.live.metrics`: name, kind, description, and the samples, each with what follows the name, labels and value.
Family = tuple[str, str, str, Sequence[tuple[str, Mapping[str, str], float]]]


class _Families(Collector):
    def __init__(self, families: Iterable[Family]) -> None:
        self._families = families

    def collect(self) -> Iterator[Metric]:
        for name, kind, about, samples in self._families:
            metric = Metric(name, about, kind)
            for suffix, labels, value in samples:
                metric.add_sample(name + suffix, dict(labels), value)
            yield metric


def exposition(families: Sequence[Family] | None) -> bytes:
    """Return the text; None stands for a run that does not answer: of its figures none is left."""
    up = 0.0 if families is None else 1.0
    is_up: Family = ("stadimeter_up", "gauge", "Whether the run answers.", [("", {}, up)])
    registry = CollectorRegistry()
    registry.register(_Families((is_up, *(families or ()))))
    return generate_latest(registry)
