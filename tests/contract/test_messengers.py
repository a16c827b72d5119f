"""Every messenger and every notifier keeps its contract."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from stadimeter.config.plugins import MESSENGERS, NOTIFIERS, WORLDS, DriverContext, load_driver
from stadimeter.messaging.apprise_notifier import AppriseNotifier, AppriseOptions
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.messaging.protocol import Patience
from stadimeter.testing.messaging_contract import (
    GONE,
    SILENT,
    MessengerContract,
    MessengerRig,
    NotifierContract,
    NotifierRig,
)
from stadimeter.testing.rig import ManualClock, impossible
from support.broker import MosquittoBroker
from support.mqtt_listener import MqttListener
from support.tunnel import Tunnel
from support.webhook_listener import HOST, WebhookListener

BASE = "stadimeter/contract"


@contextmanager
def paho_rig(tunnel: Tunnel, broker: MosquittoBroker, answer_s: float) -> Iterator[MessengerRig]:
    with ExitStack() as closing:
        broker.start()
        closing.callback(broker.stop)
        tunnel.mend()
        closing.callback(tunnel.cut)
        listener = closing.enter_context(MqttListener(broker.port))
        patience = Patience(answer_s=answer_s, first_pause_s=0.05, longest_pause_s=0.2, goodbye_s=10.0)
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


class TestAppriseNotifier(NotifierContract):
    """With the real library and a web service on the loopback interface."""

    @pytest.fixture
    def make_rig(self) -> Iterator[Callable[[], NotifierRig]]:
        pytest.importorskip("apprise")
        with WebhookListener() as service:
            options = AppriseOptions(url=f"json://{HOST}:{service.port}/hook")
            patience = Patience(first_pause_s=0.02, longest_pause_s=0.05, goodbye_s=10.0)
            yield lambda: NotifierRig(
                device=AppriseNotifier(options, "it", patience),
                delivered=lambda: [(each["title"], each["message"]) for each in service.posted],
                faults={
                    GONE: lambda begins: setattr(service, "status", 503 if begins else 200),
                    SILENT: lambda begins: service.is_free.clear() if begins else service.is_free.set(),
                },
            )


def simulated_notifier_rig() -> NotifierRig:
    model = load_driver(NOTIFIERS, "simulated")
    notifier = model().build(DriverContext(name="it", clock=ManualClock()))
    return NotifierRig(
        device=notifier,
        delivered=lambda: [(sent.item.title, sent.item.body) for sent in notifier.sent],
        faults={
            GONE: lambda begins: setattr(notifier, "is_gone", begins),
            SILENT: impossible("the simulated service answers at once"),
        },
    )


class TestSimulatedNotifier(NotifierContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], NotifierRig]:
        return simulated_notifier_rig
