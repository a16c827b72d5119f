"""Sets up paho's client: login, encryption, session and last will."""

from __future__ import annotations

import ssl
from dataclasses import dataclass, field
from pathlib import Path

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from stadimeter.config.untrusted_file import (
    CERTIFICATES_MAX_BYTES,
    SECRET_MAX_BYTES,
    read_untrusted,
    read_untrusted_text,
)
from stadimeter.core.message import Message
from stadimeter.errors import DeviceOpenError, UnreadableError
from stadimeter.messaging.mqtt_options import MqttOptions

SESSION_EXPIRY_S = 3600
WILL_DELAY_S = 5
"""A drop of the link that is shorter than this is not reported as offline. MQTT 5 only."""

PACKET_MAX = 1024
"""We subscribe to nothing, so all that a broker has to say are short answers. No larger one is read.

MQTT allows 256 MiB. A broker of MQTT 5 hears of this bound; for one that does not heed it, and with 3.1.1, `_Client`
sees to it. Even 65,535 messages of QoS 2 that are never completed then fit into 64 MiB.
"""

ONLINE = Message(topic="availability", payload="online", qos=1, retain=True)
OFFLINE = Message(topic="availability", payload="offline", qos=1, retain=True)


class BombError(Exception):
    """The other side announces a packet that is larger than anything it has to say."""


class _Client(Client):
    """Refuses a packet by its length, before there is memory for it: paho asks for the rest of one in one piece."""

    def _sock_recv(self, bufsize: int) -> bytes:
        if bufsize > PACKET_MAX:
            raise BombError(bufsize)
        return super()._sock_recv(bufsize)


@dataclass(frozen=True, slots=True, kw_only=True)
class Secrets:
    """The password and the trusted certificates, read when a messenger opens; None for no login or no encryption."""

    password: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | None = None


def read_secrets(options: MqttOptions) -> Secrets:
    """Read the files that the configuration names; raises `DeviceOpenError` for one that is of no use."""
    return Secrets(
        password=_read_password(options.password_file) if options.password_file else None,
        tls=_tls_context(options.ca_file) if options.tls else None,
    )


def make_client(options: MqttOptions, secrets: Secrets, version: MQTTProtocolVersion, answer_s: float) -> Client:
    """Make a client that is ready to connect. It has no thread, and tries nothing by itself."""
    is_v5 = version == MQTTProtocolVersion.MQTTv5
    client = _Client(
        CallbackAPIVersion.VERSION2,
        client_id=options.client_id,
        # A session of 3.1.1 never ends. We subscribe to nothing, so there is nothing to keep in it.
        clean_session=None if is_v5 else True,
        protocol=version,
        reconnect_on_failure=False,
    )
    client.connect_timeout = answer_s
    if options.username is not None:
        client.username_pw_set(options.username, secrets.password)
    if secrets.tls is not None:
        client.tls_set_context(secrets.tls)
    _set_session(client, options, is_v5=is_v5)
    return client


def publish_properties(message: Message) -> Properties | None:
    """Return the properties of MQTT 5 that a message needs; None for none."""
    if message.expires_s is None:
        return None
    return _properties(PacketTypes.PUBLISH, MessageExpiryInterval=message.expires_s)


def _set_session(client: Client, options: MqttOptions, *, is_v5: bool) -> None:
    session, will = None, None
    if is_v5:
        session = _properties(PacketTypes.CONNECT, SessionExpiryInterval=SESSION_EXPIRY_S, MaximumPacketSize=PACKET_MAX)
        will = _properties(PacketTypes.WILLMESSAGE, WillDelayInterval=WILL_DELAY_S)
    client.will_set(f"{options.base}/{OFFLINE.topic}", OFFLINE.payload, OFFLINE.qos, OFFLINE.retain, will)
    client.connect_async(
        options.host,
        options.broker_port,
        keepalive=round(options.keepalive),
        clean_start=False,
        properties=session,
    )


def _properties(packet_type: int, **values: int) -> Properties:
    properties = Properties(packet_type)  # type: ignore[no-untyped-call] # paho has not typed it
    for name, value in values.items():
        setattr(properties, name, value)
    return properties


def _read_password(file: Path) -> str:
    try:
        lines = read_untrusted_text(file, SECRET_MAX_BYTES).splitlines()
    except UnreadableError as error:
        raise DeviceOpenError(f"password_file {file} cannot be read: {error.reason}") from error
    if not lines or not lines[0]:
        raise DeviceOpenError(f"password_file {file} has no password on its first line")
    return lines[0]


def _tls_context(ca_file: Path | None) -> ssl.SSLContext:
    try:
        certificates = _certificates(ca_file) if ca_file else None
        context = ssl.create_default_context(cadata=certificates)
    except UnreadableError as error:
        raise DeviceOpenError(f"ca_file {ca_file} cannot be read: {error.reason}") from error
    except (ssl.SSLError, ValueError) as error:
        reason = getattr(error, "reason", None) or str(error)
        raise DeviceOpenError(f"ca_file {ca_file} holds no certificate that can be used ({reason})") from error
    context.sslsocket_class = _TidySocket
    return context


def _certificates(ca_file: Path) -> str:
    return read_untrusted(ca_file, CERTIFICATES_MAX_BYTES).decode("ascii", "ignore")  # remarks may be in any alphabet


class _TidySocket(ssl.SSLSocket):
    """Closes itself when the handshake fails, which paho leaves to the garbage collector."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise
