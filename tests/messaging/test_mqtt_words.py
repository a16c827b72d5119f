from __future__ import annotations

import socket
import ssl

import pytest

from stadimeter.messaging import mqtt_client as words
from stadimeter.messaging.mqtt import MqttOptions
from support.each_case import each_case

OPTIONS = MqttOptions(host="broker.local", node="garage")


@each_case(
    ("error", "expected"),
    [
        (socket.gaierror(-2, "Name or service not known"), "no address is known for the host 'broker.local'"),
        (ConnectionRefusedError(111, "Connection refused"), "broker.local:1883 refused the connection"),
        (TimeoutError("timed out"), "broker.local:1883 does not answer"),
        (OSError(113, "No route to host"), "broker.local:1883 cannot be reached: No route to host"),
        (ConnectionResetError(104, "Connection reset by peer"), "broker.local:1883 hung up without an answer"),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER]"), "broker.local:1883 does not speak TLS as expected"),
    ],
)
def test_why_there_is_no_connection_is_said_in_one_line(error, expected):
    said = words.describe_connect_error(OPTIONS, error)
    assert expected in said
    assert "\n" not in said


@pytest.mark.parametrize("error", [TimeoutError("handshake"), ConnectionResetError(), ssl.SSLEOFError(8, "EOF")])
def test_with_tls_the_port_is_suspected(error):
    assert "is this its port for TLS?" in words.describe_connect_error(OPTIONS.model_copy(update={"tls": True}), error)
