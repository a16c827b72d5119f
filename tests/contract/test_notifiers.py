"""Every notifier keeps the contract."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from stadimeter.config.plugins import NOTIFIERS, DriverContext, load_driver
from stadimeter.messaging.apprise_notifier import AppriseNotifier, AppriseOptions
from stadimeter.messaging.back_off import Patience
from stadimeter.testing.messaging_contract import GONE, SILENT, NotifierContract, NotifierRig
from stadimeter.testing.rig import ManualClock, impossible
from support.webhook_listener import HOST, WebhookListener


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


def simulated_rig() -> NotifierRig:
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
        return simulated_rig
