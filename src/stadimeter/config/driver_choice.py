"""A driver and its options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stadimeter.config.plugins import Options, Plugin


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverChoice:
    """A driver that a configuration names.

    Attributes:
        name: The part's name in the configuration, such as ``motor``.
        driver: The driver's name, such as ``vibration-motor``.
    """

    name: str
    driver: str
    plugin: Plugin[Any]
    options: Options
