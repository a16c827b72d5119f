from __future__ import annotations

import re

import pytest
from pydantic import ValidationError

from stadimeter.messaging.mqtt import MqttOptions
from stadimeter.messaging.mqtt_client import default_node
from support.each_case import each_case


def options(**table: object) -> MqttOptions:
    return MqttOptions.model_validate(table)


def test_an_empty_table_means_the_broker_on_this_computer():
    assert (options().place, options().base) == ("127.0.0.1:1883", f"stadimeter/{default_node()}")


@pytest.mark.parametrize(
    ("host_name", "expected"), [("garage", "garage"), ("my pi.local", "my-pi"), ("ürgö", "rg"), ("...", "node")]
)
def test_the_default_node_is_the_computers_name_in_plain_characters(host_name, expected, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: host_name)
    assert options().node == expected
    assert re.fullmatch(r"stadimeter-[a-zA-Z0-9_-]+", options().client_id)


def test_the_port_follows_tls_unless_it_is_given():
    assert options(tls=True).broker_port == 8883
    assert options(tls=True, port=1884).broker_port == 1884


@each_case(
    ("table", "expected"),
    [
        ({"password": "secret"}, "password"),
        ({"node": "my node"}, "letters, digits"),
        ({"node": ""}, "letters, digits"),
        ({"host": ""}, "not a host name"),
        ({"host": "mqtt://broker"}, "not a host name"),
        ({"host": "a..b"}, "not a host name"),
        ({"port": 0}, "greater than or equal to 1"),
        ({"port": 65536}, "less than or equal to 65535"),
        ({"base_topic": "home/#"}, "not a base topic"),
        ({"base_topic": "/home"}, "not a base topic"),
        ({"base_topic": "$SYS/home"}, "not a base topic"),
        ({"base_topic": ""}, "not a base topic"),
        ({"protocol": "3.1"}, "3.1.1"),
        ({"password_file": "secret.txt"}, "without a username"),
        ({"ca_file": "ca.pem"}, "without tls"),
        ({"certificate_file": "it.crt", "key_file": "it.key"}, "certificate_file is given without tls"),
        ({"certificate_file": "it.crt", "tls": True}, "belong together"),
        ({"key_file": "it.key", "tls": True}, "belong together"),
        ({"commands": "some"}, "'off', 'alarms' or 'all'"),
        ({"hots": "broker"}, "hots"),
    ],
)
def test_a_wrong_option_is_named(table, expected):
    with pytest.raises(ValidationError, match=re.escape(expected)):
        options(**table)
