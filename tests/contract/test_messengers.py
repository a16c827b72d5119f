"""Every messenger keeps the contract."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from stadimeter.config.plugins import MESSENGERS, WORLDS, DriverContext, load_driver
from stadimeter.messaging.back_off import Patience
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.testing.messaging_contract import GONE, SILENT, MessengerContract, MessengerRig
from stadimeter.testing.rig import ManualClock, impossible
from support.broker import MosquittoBroker
from support.mqtt_listener import MqttListener
from support.tunnel import Tunnel

BASE = "stadimeter/contract"


@contextmanager
def paho_rig(tunnel: Tunnel, broker: MosquittoBroker, answer_s: float) -> Iterator[MessengerRig]:
    with ExitStack() as closing:
        broker.start()
        closing.callback(broker.stop)
        tunnel.mend()
        closing.callback(tunnel.cut)
        listener = closing.enter_context(MqttListener(broker.port))
        patience = Patience(answer_s=answer_s, first_pause_s=0.05, longest_pause_s=0.2)
        messenger = PahoMessenger(MqttOptions(port=tunnel.port, node="contract"), patience)
        closing.callback(messenger.close)

        def fall_silent(begins: bool) -> None:
            if begins:
                tunnel.clog()
            else:
                tunnel.cut()
                tunnel.mend()

        yield MessengerRig(
            device=messenger,
            delivered=lambda: [(heard.topic.removeprefix(f"{BASE}/"), heard.payload) for heard in listener.heard],
            faults={GONE: lambda begins: tunnel.cut() if begins else tunnel.mend(), SILENT: fall_silent},
        )


class TestPahoMessenger(MessengerContract):
    """With mosquitto."""

    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Iterator[Callable[[], MessengerRig]]:
        broker = MosquittoBroker(tmp_path)
        with paho_rig(Tunnel(broker.port), broker, answer_s=10.0) as rig:
            yield lambda: rig


class TestPahoMessengerWithABrokerOfMqtt311(MessengerContract):
    """With a broker that does not answer MQTT 5."""

    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Iterator[Callable[[], MessengerRig]]:
        broker = MosquittoBroker(tmp_path)
        with paho_rig(Tunnel(broker.port, is_mqtt_5_unanswered=True), broker, answer_s=0.3) as rig:
            yield lambda: rig


def simulated_rig() -> MessengerRig:
    context = DriverContext(name="it", clock=ManualClock())
    world_model = load_driver(WORLDS, "simulated")
    world = world_model().build(context)
    model = load_driver(MESSENGERS, "simulated")
    messenger = model().build(context)
    return MessengerRig(
        device=messenger,
        delivered=lambda: [(sent.item.topic, sent.item.payload) for sent in messenger.sent],
        faults={
            GONE: lambda begins: setattr(world.faults, "broker_gone", begins),
            SILENT: impossible("the simulated broker acknowledges at once"),
        },
    )


class TestSimulatedMessenger(MessengerContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], MessengerRig]:
        return simulated_rig
