"""Parts an MQTT messenger needs to connect: its options, and paho's client with login, encryption and last will."""

from __future__ import annotations

import re
import socket
import ssl
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Self

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions
from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import Duration, FilePath
from stadimeter.core.home_assistant import DiscoveryPlace
from stadimeter.core.message import AVAILABILITY, RETAINED, Message
from stadimeter.messaging.outbox import DirectMessage
from stadimeter.messaging.protocol import CommandLevel

NODE_CHARACTERS = "letters, digits, '-' and '_'"
PLAIN_PORT = 1883
TLS_PORT = 8883


def default_node() -> str:
    """Return the computer's name, reduced to the characters that a node may have."""
    name = socket.gethostname().split(".")[0]
    return re.sub(r"[^a-zA-Z0-9_-]+", "-", name).strip("-") or "node"


def _check_node(node: str) -> str:
    if not re.fullmatch(r"[a-zA-Z0-9_-]+", node):
        raise ValueError(f"{node!r} is not a node name; use {NODE_CHARACTERS} only, such as 'garage-1'")
    return node


def _check_host(host: str) -> str:
    try:
        well_formed = bool(host.strip()) and host == host.strip() and bool(host.encode("idna"))
    except UnicodeError:
        well_formed = False
    if not well_formed or "/" in host:
        raise ValueError(
            f"{host!r} is not a host name or an address; write it such as '192.168.1.10' or 'broker.local'"
        )
    return host


def _is_topic(topic: str) -> bool:
    return bool(topic) and topic[0] not in "/$" and topic[-1] != "/" and not re.search(r"[+#\s\x00]", topic)


def _check_base_topic(topic: str | None) -> str | None:
    if topic is not None and not _is_topic(topic):
        raise ValueError(
            f"{topic!r} is not a base topic; write it such as 'stadimeter/garage', without '+', '#' or spaces"
        )
    return topic


def _check_topic(topic: str) -> str:
    if not _is_topic(topic):
        raise ValueError(f"{topic!r} is not a topic; write it as in Home Assistant, such as 'homeassistant/status'")
    return topic


def _check_keepalive(seconds: float) -> float:
    if not 1 <= seconds <= 65_535:
        raise ValueError(f"{seconds:g} s is not a keepalive; choose from 1 s to 65535 s, such as '15 s'")
    return seconds


class MqttSettings(DriverOptions):
    """The table of an ``mqtt`` messenger, without its driver."""

    host: Annotated[str, AfterValidator(_check_host)] = "127.0.0.1"
    """The broker's name or address."""
    port: Annotated[int, Field(ge=1, le=65_535)] | None = None
    """Its port; 1883, or 8883 with TLS, if not given."""
    node: Annotated[str, AfterValidator(_check_node)] = Field(default_factory=default_node)
    """This computer's name in topics and in the client id."""
    base_topic: Annotated[str | None, AfterValidator(_check_base_topic)] = None
    """What every topic begins with; ``stadimeter/<node>`` if not given."""
    username: Annotated[str, Field(min_length=1)] | None = None
    """The name to log in with; None for no login."""
    password_file: FilePath | None = None
    """A text file with the password on its first line."""
    tls: bool = False
    """Whether to encrypt. The broker's certificate and name are then always checked."""
    ca_file: FilePath | None = None
    """The certificate of the authority that signed the broker's; None for those that the system trusts."""
    certificate_file: FilePath | None = None
    """Our own certificate, for a broker that asks for one in place of a password."""
    key_file: FilePath | None = None
    """The key that belongs to it, without a passphrase."""
    keepalive: Annotated[Duration, AfterValidator(_check_keepalive)] = 10.0
    """After this time without a word the link is probed, and given up if nothing answers for as long again."""
    protocol: Literal["auto", "5", "3.1.1"] = "auto"
    """The version of MQTT. ``auto`` is 5, and 3.1.1 if the broker does not speak 5."""
    commands: CommandLevel = "alarms"
    """What other programs may ask for. ``alarms`` is all but what lets outputs act, takes pictures or writes files."""
    home_assistant: bool = True
    """Whether Home Assistant discovers this node by itself."""
    discovery_prefix: Annotated[str, AfterValidator(_check_topic)] = "homeassistant"
    """What Home Assistant listens to for discovery."""
    birth_topic: Annotated[str, AfterValidator(_check_topic)] = "homeassistant/status"
    """Where Home Assistant says ``online`` when it starts."""

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file is given without a username; give both or neither")
        for name in ("ca_file", "certificate_file"):
            if getattr(self, name) is not None and not self.tls:
                raise ValueError(f"{name} is given without tls; write 'tls = true' to encrypt")
        if (self.certificate_file is None) is not (self.key_file is None):
            raise ValueError("certificate_file and key_file belong together; give both or neither")
        return self

    @property
    def broker_port(self) -> int:
        """The port that is meant."""
        return self.port or (TLS_PORT if self.tls else PLAIN_PORT)

    @property
    def place(self) -> str:
        """The broker, for messages: ``host:port``."""
        return f"{self.host}:{self.broker_port}"

    @property
    def base(self) -> str:
        """The prefix of every topic."""
        return self.base_topic or f"stadimeter/{self.node}"

    @property
    def discovery_place(self) -> DiscoveryPlace | None:
        """The place at which Home Assistant discovers this node; None if it shall not."""
        if not self.home_assistant:
            return None
        return DiscoveryPlace(node=self.node, base=self.base, prefix=self.discovery_prefix)

    @property
    def retained_topic(self) -> str:
        """Topic of the list of retained topics, below the base topic, which several nodes may share."""
        return f"{RETAINED.first_level}/{self.node}"

    @property
    def retained_page_bytes(self) -> int:
        """The size of a page of that list: what a packet has room for, beside its topic and what a broker adds."""
        return PAGE_PACKET_MAX - len(f"{self.base}/{self.retained_topic}/999".encode()) - 64

    @property
    def packet_max(self) -> int:
        """The largest packet that is read."""
        return PAGE_PACKET_MAX if self.commands == "off" else PACKET_MAX

    @property
    def client_id(self) -> str:
        """The name by which the broker knows us. It knows only one client of a name at a time."""
        return f"stadimeter-{self.node}"


# A drop of the link that is shorter than this is not reported as offline. MQTT 5 only.
SESSION_EXPIRY_S = 3600
WILL_DELAY_S = 5

# We subscribe to short pages of our own and to requests, so all that a broker has to say is short. No larger packet is
# read: the second bound is for requests, with room to answer those that are somewhat too large.
#
# MQTT allows 256 MiB. A broker of MQTT 5 hears of this bound; for one that does not heed it, and with 3.1.1, `_Client`
# sees to it. It also bounds messages of QoS 2 that are never completed: we ask for none.
PAGE_PACKET_MAX = 1024
PACKET_MAX = 8192
INCOMPLETE_MAX = 64

# A response that waited for longer in a broker is of no use to whoever asked.
RESPONSE_EXPIRES_S = 30

# No message of stadimeter is as long. Of a longer one, a program that listens keeps the beginning, which is no JSON.
LISTENING_PACKET_MAX = 16_384

# Read without a look at the clock.
LISTENING_PACKETS_MAX = 500

ONLINE = Message(topic=AVAILABILITY.path, payload="online", qos=1, retain=True)
OFFLINE = Message(topic=AVAILABILITY.path, payload="offline", qos=1, retain=True)


class OversizedPacketError(Exception):
    """The other side announces a packet that is larger than anything it has to say."""


class _Client(Client):
    """Refuses a packet by its length, before there is memory for it: paho asks for the rest of one in one piece."""

    packet_max = PACKET_MAX

    def _sock_recv(self, bufsize: int) -> bytes:
        if bufsize > self.packet_max or len(self._in_messages) > INCOMPLETE_MAX:
            raise OversizedPacketError(bufsize)
        return super()._sock_recv(bufsize)


class ListeningClient(Client):
    """Reads what comes in great numbers: many packets in one piece, and of one that is too long only the beginning."""

    packet_max = LISTENING_PACKET_MAX
    _unread = b""
    _read_to = 0

    def loop(self, timeout: float = 1.0) -> MQTTErrorCode:
        """Wait for packets, and read those that came together; paho would ask the system anew before each."""
        code = super().loop(timeout)
        packets_left = LISTENING_PACKETS_MAX
        while code == MQTTErrorCode.MQTT_ERR_SUCCESS and self._read_to < len(self._unread) and packets_left:
            code = self.loop_read()
            packets_left -= 1
        return code

    def _sock_recv(self, bufsize: int) -> bytes:
        if bufsize > self.packet_max:
            del self._in_packet["packet"][self.packet_max :]
            bufsize = self.packet_max
        if self._read_to >= len(self._unread):
            self._unread, self._read_to = super()._sock_recv(65_536), 0
        found = self._unread[self._read_to : self._read_to + bufsize]
        self._read_to += bufsize
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Secrets:
    """The password and the trusted certificates, read when a messenger opens; None for no login or no encryption.

    Attributes:
        client_suffix: The end of the client id. A broker ends a connection when another begins with its client id,
            whoever that is: so only who knows the secret can guess it.
    """

    password: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | None = None
    client_suffix: str = field(default="", repr=False)


def make_client(
    options: MqttSettings,
    secrets: Secrets,
    version: MQTTProtocolVersion,
    answer_s: float,
    kind: type[_Client | ListeningClient] = _Client,
    packet_max: int | None = None,
) -> Client:
    """Make a client that is ready to connect. It has no thread, and tries nothing by itself.

    Args:
        packet_max: The largest packet that is read; None for that of the options.
    """
    is_v5 = version == MQTTProtocolVersion.MQTTv5
    client = kind(
        CallbackAPIVersion.VERSION2,
        client_id=f"{options.client_id}{secrets.client_suffix}",
        # A session of 3.1.1 never ends. We subscribe anew each time, so there is nothing to keep in it.
        clean_session=None if is_v5 else True,
        protocol=version,
        reconnect_on_failure=False,
    )
    client.packet_max = packet_max or options.packet_max
    client.connect_timeout = answer_s
    client.on_socket_open = _send_at_once
    if options.username is not None:
        client.username_pw_set(options.username, secrets.password)
    if secrets.tls is not None:
        client.tls_set_context(secrets.tls)
    _set_session(client, options, client.packet_max, is_v5=is_v5)
    return client


def _send_at_once(_client: Client, _data: Any, connection: Any) -> None:
    """Have the system send a short message although the one before was not confirmed yet: that takes up to 40 ms."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def say_goodbye(client: Client, version: MQTTProtocolVersion) -> None:
    """Disconnect for good: the broker forgets the session."""
    is_v5 = version == MQTTProtocolVersion.MQTTv5
    client.disconnect(properties=_properties(PacketTypes.DISCONNECT, SessionExpiryInterval=0) if is_v5 else None)


def publish_properties(message: Message) -> Properties | None:
    """Return the properties of MQTT 5 that a message needs; None for none."""
    if isinstance(message, DirectMessage):
        return _response_properties(message.content_type, message.correlation)
    if message.expires_s is None:
        return None
    return _properties(PacketTypes.PUBLISH, MessageExpiryInterval=message.expires_s)


def subscribe(client: Client, topics: Collection[str], identifier: int | None) -> int | None:
    """Subscribe to topics with QoS 1, and return the number of the broker's answer; None if that is impossible.

    Args:
        identifier: With MQTT 5, what each message shall carry that comes because of it; None for MQTT 3.1.1.
    """
    if identifier is None:
        return client.subscribe([(topic, 1) for topic in topics])[1]
    # `retainHandling` 2: what was kept before is not sent. `retainAsPublished`: what is to be kept now says so.
    options = SubscribeOptions(qos=1, noLocal=True, retainAsPublished=True, retainHandling=2)
    marked = _properties(PacketTypes.SUBSCRIBE, SubscriptionIdentifier=identifier)
    return client.subscribe([(topic, options) for topic in topics], properties=marked)[1]


def _response_properties(content_type: str, correlation: bytes | None) -> Properties:
    more = {} if correlation is None else {"CorrelationData": correlation}
    return _properties(PacketTypes.PUBLISH, MessageExpiryInterval=RESPONSE_EXPIRES_S, ContentType=content_type, **more)


def _set_session(client: Client, options: MqttSettings, packet_max: int, *, is_v5: bool) -> None:
    session, will = None, None
    if is_v5:
        session = _properties(PacketTypes.CONNECT, SessionExpiryInterval=SESSION_EXPIRY_S, MaximumPacketSize=packet_max)
        will = _properties(PacketTypes.WILLMESSAGE, WillDelayInterval=WILL_DELAY_S)
    client.will_set(f"{options.base}/{OFFLINE.topic}", OFFLINE.payload, OFFLINE.qos, OFFLINE.retain, will)
    client.connect_async(
        options.host,
        options.broker_port,
        keepalive=round(options.keepalive),
        clean_start=False,
        properties=session,
    )


def _properties(packet_type: int, **values: int | str | bytes) -> Properties:
    properties = Properties(packet_type)  # type: ignore[no-untyped-call] # paho has not typed it
    for name, value in values.items():
        setattr(properties, name, value)
    return properties
