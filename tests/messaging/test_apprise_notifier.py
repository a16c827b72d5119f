"""The notifier that uses apprise: what it says when something is wrong, and that it never says a secret."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import pytest
from pydantic import ValidationError

from stadimeter.core.decision import Severity
from stadimeter.core.message import Notification
from stadimeter.errors import DeviceOpenError, DriverUnavailableError
from stadimeter.messaging.apprise_notifier import AppriseNotifier, AppriseOptions
from stadimeter.messaging.protocol import Patience
from stadimeter.testing.rig import eventually
from support.webhook_listener import HOST, WebhookListener

PATIENCE = Patience(first_pause_s=0.02, longest_pause_s=0.05, goodbye_s=10.0)
NOTE = Notification(title="door", body="0.42 m", severity=Severity.SAFETY)


@pytest.fixture
def service() -> Iterator[WebhookListener]:
    pytest.importorskip("apprise")
    with WebhookListener() as listener:
        yield listener


def notifier(url: str, patience: Patience = PATIENCE) -> AppriseNotifier:
    return AppriseNotifier(AppriseOptions(url=url), "phone", patience)


def test_without_the_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "apprise", None)
    with pytest.raises(DriverUnavailableError, match=r"'phone' needs apprise: .*stadimeter\[notify\]"):
        notifier("json://127.0.0.1/").open()


def test_the_severity_reaches_the_service(service):
    phone = notifier(f"json://{HOST}:{service.port}")
    phone.open()
    for severity in (Severity.INFO, Severity.WARNING, Severity.ALARM, Severity.SAFETY):
        phone.notify(Notification(title="t", body="b", severity=severity))
    phone.close()
    assert [posted["type"] for posted in service.posted] == ["info", "warning", "failure", "failure"]


def test_the_url_may_stand_in_a_file_of_its_own(service, tmp_path):
    file = tmp_path / "phone.txt"
    file.write_text(f"json://{HOST}:{service.port}/hook\n\n# the hall\n")
    phone = AppriseNotifier(AppriseOptions(url_file=file), "phone", PATIENCE)
    phone.open()
    phone.notify(NOTE)
    phone.close()
    assert json.dumps(service.posted[0]["message"]) == '"0.42 m"'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot be read: there is no such file"),
        (b"", "is not an address such as 'ntfys://…'"),
        (b"top-secret-token", "is not an address such as 'ntfys://…'"),
        (b"json://\xff\xfe", "it is not UTF-8 text (it has the byte 0xFF, in Windows-1252 ÿ)"),
    ],
)
def test_a_file_without_a_url_is_refused_without_repeating_what_it_holds(tmp_path, text, words):
    file = tmp_path / "phone.txt"
    if text is not None:
        file.write_bytes(text)
    with pytest.raises(DeviceOpenError) as raised:
        AppriseNotifier(AppriseOptions(url_file=file), "phone").open()
    assert words in str(raised.value)
    assert str(file) in str(raised.value)
    assert "top-secret" not in str(raised.value)


@pytest.mark.parametrize("url", ["nosuchservice://top-secret", "tgram://top-secret"])
def test_a_url_that_apprise_does_not_understand_is_refused_without_repeating_it(url, capfd):
    pytest.importorskip("apprise")
    with pytest.raises(DeviceOpenError) as raised:
        notifier(url).open()
    assert f"({url.partition(':')[0]}://…)" in str(raised.value)
    assert "top-secret" not in str(raised.value)
    assert capfd.readouterr() == ("", "")


def test_a_url_that_was_taken_out_of_a_recording_is_asked_for():
    with pytest.raises(DeviceOpenError, match="taken out when the configuration was recorded"):
        notifier("hidden://").open()


@pytest.mark.parametrize("table", [{}, {"url": "json://a", "url_file": "b"}])
def test_a_notifier_has_its_url_in_one_place(table):
    with pytest.raises(ValidationError, match="either url or url_file"):
        AppriseOptions(**table)


def test_a_refusal_is_told_with_its_reason_and_without_secrets(service, capfd):
    service.status = 403
    phone = notifier(f"json://me:top%2Dsecret@{HOST}:{service.port}/hook-4711")
    phone.open()
    phone.notify(NOTE)
    words = eventually(phone.trouble)
    assert words.startswith("the notifier 'phone': ")
    assert "403" in words
    phone.close()
    for secret in ("top%2Dsecret", "top-secret", "4711"):
        assert secret not in words + repr(phone)
    assert capfd.readouterr() == ("", "")


def test_a_service_that_hangs_holds_up_neither_the_run_nor_its_end(service):
    service.is_free.clear()
    phone = notifier(f"json://{HOST}:{service.port}", Patience(goodbye_s=0.01))
    phone.open()
    for _ in range(50):
        phone.notify(NOTE)
    service.asked.wait()
    phone.close()
    assert phone.undelivered() == (NOTE,) * 50
    service.is_free.set()
