"""Real brokers, a cable that can be cut, and messengers that are closed in the end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from stadimeter.config.plugins import MESSENGERS, DriverContext, load_driver
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.messaging.protocol import Patience
from stadimeter.testing.rig import ManualClock
from support.broker import BrokerAccess, MosquittoBroker
from support.mqtt_listener import MqttListener
from support.tunnel import Tunnel

MakeBroker = Callable[..., MosquittoBroker]
MakeMessenger = Callable[..., PahoMessenger]

ANSWER_S = 10.0  # enough on a busy computer


@pytest.fixture
def start_broker(tmp_path: Path, closing: ExitStack) -> MakeBroker:
    """Return a function that starts a broker with the given access."""

    def start(**access: Any) -> MosquittoBroker:
        broker = MosquittoBroker(tmp_path, BrokerAccess(**access))
        broker.start()
        closing.callback(broker.stop)
        return broker

    return start


@pytest.fixture
def broker(start_broker: MakeBroker) -> MosquittoBroker:
    """Return a broker that lets everybody in."""
    return start_broker()


@pytest.fixture
def make_messenger(closing: ExitStack) -> MakeMessenger:
    """Return a function that makes a messenger as a configuration would, but an impatient one."""

    def make(
        port: int, node: str = "it", answer_s: float = ANSWER_S, goodbye_s: float = 1.0, **options: Any
    ) -> PahoMessenger:
        model = load_driver(MESSENGERS, "mqtt")
        checked = model.model_validate({"port": port, "node": node, **options})
        assert isinstance(checked.build(DriverContext(name="it", clock=ManualClock())), PahoMessenger)
        patience = Patience(answer_s=answer_s, first_pause_s=0.05, longest_pause_s=0.2, goodbye_s=goodbye_s)
        messenger = PahoMessenger(checked, patience)
        closing.callback(messenger.close)
        return messenger

    return make


@pytest.fixture
def listen(closing: ExitStack) -> Callable[..., MqttListener]:
    """Return a function that subscribes to everything at a broker's port."""

    def subscribe(port: int, login: tuple[str, str] | None = None, *, is_v5: bool = False) -> MqttListener:
        return closing.enter_context(MqttListener(port, login, is_v5=is_v5))

    return subscribe


@pytest.fixture
def lay_tunnel(closing: ExitStack) -> Callable[[int], Tunnel]:
    """Return a function that lays a tunnel to a broker's port."""

    def lay(port: int) -> Tunnel:
        tunnel = Tunnel(port)
        tunnel.mend()
        closing.callback(tunnel.cut)
        return tunnel

    return lay
