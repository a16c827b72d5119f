from __future__ import annotations

from support.pins import lgpio, pretended_pi  # noqa: F401 - fixtures
