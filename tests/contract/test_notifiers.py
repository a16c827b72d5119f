"""Every notifier keeps the contract."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from stadimeter.config.plugins import NOTIFIERS, DriverContext, load_plugin
from stadimeter.messaging.apprise_notifier import AppriseNotifier, AppriseOptions
from stadimeter.messaging.back_off import Patience
from stadimeter.testing.manual_clock import ManualClock
from stadimeter.testing.notifier_contract import NotifierContract, NotifierRig
from support.webhook_listener import HOST, WebhookListener


class TestAppriseNotifier(NotifierContract):
    """With the real library and a web service on the loopback interface."""

    @pytest.fixture
    def rig(self) -> Iterator[NotifierRig]:
        pytest.importorskip("apprise")
        with WebhookListener() as service:
            options = AppriseOptions(url=f"json://{HOST}:{service.port}/hook")
            patience = Patience(first_pause_s=0.02, longest_pause_s=0.05, goodbye_s=10.0)

            def answer(status: int) -> None:
                service.status = status

            yield NotifierRig(
                notifier=AppriseNotifier(options, "it", patience),
                delivered=lambda: [(each["title"], each["message"]) for each in service.posted],
                break_link=lambda: answer(503),
                mend_link=lambda: answer(200),
            )


class TestSimulatedNotifier(NotifierContract):
    @pytest.fixture
    def rig(self) -> NotifierRig:
        plugin = load_plugin(NOTIFIERS, "simulated")
        notifier = plugin.build(plugin.options(), DriverContext(name="it", clock=ManualClock()))

        def set_gone(*, gone: bool) -> None:
            notifier.is_gone = gone

        return NotifierRig(
            notifier=notifier,
            delivered=lambda: [(sent.notification.title, sent.notification.body) for sent in notifier.sent],
            break_link=lambda: set_gone(gone=True),
            mend_link=lambda: set_gone(gone=False),
        )
