"""Fixtures for drivers on pins: an lgpio that remembers what it was given, on a Raspberry Pi that is none."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

PRETEND = Path(__file__).parent / "pretend"
LGPIO_MODULES = ("lgpio", "gpiozero.pins.lgpio")


@pytest.fixture
def pretended_pi(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let `import lgpio` find the pretended one, on a pretended Raspberry Pi 3."""
    monkeypatch.delenv("GPIOZERO_PIN_FACTORY", raising=False)
    monkeypatch.syspath_prepend(str(PRETEND))
    monkeypatch.setattr("gpiozero.pins.local.get_pi_revision", lambda: 0xA02082)
    real = {name: sys.modules.pop(name) for name in LGPIO_MODULES if name in sys.modules}
    yield
    for name in LGPIO_MODULES:
        sys.modules.pop(name, None)
    sys.modules.update(real)


@pytest.fixture
def lgpio(pretended_pi: None) -> Callable[[], ModuleType]:
    """Return a function that returns the pretended lgpio, once a driver has imported it."""
    return lambda: sys.modules["lgpio"]
