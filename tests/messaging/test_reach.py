"""Whether a broker can be reached, as `doctor` asks: once, and beside a running instance."""

from __future__ import annotations

import socket

import pytest

from stadimeter.messaging import mqtt
from stadimeter.messaging.mqtt import MqttOptions
from stadimeter.testing.rig import eventually
from support.broker import HOST, free_port


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "ASKED_S", 10.0)  # enough on a busy computer


def options(port: int, **more: object) -> MqttOptions:
    return MqttOptions.model_validate({"host": HOST, "port": port, "node": "it", **more})


def test_a_running_instance_keeps_its_connection_and_no_one_hears_of_the_question(broker, make_messenger, listen):
    listener = listen(broker.port)
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    listener.wait_for("stadimeter/it/availability", "online")
    assert options(broker.port).reach() == ""
    assert messenger.trouble() == ""
    messenger.close()
    listener.wait_for_payloads("stadimeter/it/availability", ["online", "offline"])
    assert {heard.topic for heard in listener.heard if not heard.topic.startswith("$SYS")} == {
        "stadimeter/it/availability"
    }


@pytest.mark.parametrize(("password", "words"), [("open sesame", ""), ("sesame", "refused the login of 'pi'")])
def test_the_login_of_the_configuration_is_tried(start_broker, tmp_path, password, words):
    broker = start_broker(username="pi", password="open sesame")
    (tmp_path / "password").write_text(password)
    trouble = options(broker.port, username="pi", password_file=str(tmp_path / "password")).reach()
    assert words in trouble
    assert bool(trouble) == bool(words)
    assert "sesame" not in trouble


def test_each_way_not_to_answer_has_its_words(tmp_path, monkeypatch):
    assert "is a broker running there?" in options(free_port()).reach()
    missing = options(free_port(), username="pi", password_file=str(tmp_path / "none"))
    assert "cannot be read" in missing.reach()
    monkeypatch.setattr(mqtt, "ASKED_S", 0.2)
    with socket.create_server((HOST, 0)) as silent:
        assert options(silent.getsockname()[1]).reach().endswith("does not answer")
