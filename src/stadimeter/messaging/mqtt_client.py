"""A client of MQTT before anything is sent: its options and secrets, paho itself, and the events of a connection."""

from __future__ import annotations

import hashlib
import re
import socket
import ssl
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions
from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.addresses import not_trusted
from stadimeter.config.files import CERTIFICATES_MAX_BYTES, SECRET_MAX_BYTES, read_untrusted, read_untrusted_text
from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import FilePath
from stadimeter.core.home_assistant import DiscoveryPlace
from stadimeter.core.message import AVAILABILITY, Message
from stadimeter.errors import DeviceOpenError, UnreadableError
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
        raise ValueError(f"{topic!r} is not a topic; write it as in Home Assistant, such as 'homeassistant'")
    return topic


# After this time without a word the link is probed, and given up if nothing answers for as long again.
KEEPALIVE_S = 10


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
    protocol: Literal["auto", "5", "3.1.1"] = "auto"
    """The version of MQTT. ``auto`` is 5, and 3.1.1 if the broker does not speak 5."""
    commands: CommandLevel = "alarms"
    """What other programs may ask for. ``alarms`` is all but what lets outputs act, takes pictures or writes files."""
    home_assistant: bool = True
    """Whether Home Assistant discovers this node by itself."""
    discovery_prefix: Annotated[str, AfterValidator(_check_topic)] = "homeassistant"
    """What Home Assistant listens to for discovery."""

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
    def discovery_at(self) -> DiscoveryPlace:
        """The place at which Home Assistant would discover this node."""
        return DiscoveryPlace(node=self.node, base=self.base, prefix=self.discovery_prefix)

    @property
    def discovery_place(self) -> DiscoveryPlace | None:
        """The place at which Home Assistant discovers this node; None if it shall not."""
        return self.discovery_at if self.home_assistant else None

    @property
    def client_id(self) -> str:
        """The name by which the broker knows us. It knows only one client of a name at a time."""
        return f"stadimeter-{self.node}"


# A drop of the link that is shorter than this is not reported as offline. MQTT 5 only.
SESSION_EXPIRY_S = 3600
WILL_DELAY_S = 5

# All that a broker has to say to us is short. One of MQTT 5 hears of this bound, and sends nothing longer.
PACKET_MAX = 256 * 1024

# A response that waited for longer in a broker is of no use to whoever asked.
RESPONSE_EXPIRES_S = 30

ONLINE = Message(topic=AVAILABILITY.path, payload="online", qos=1, retain=True)
OFFLINE = Message(topic=AVAILABILITY.path, payload="offline", qos=1, retain=True)


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


def make_client(options: MqttSettings, secrets: Secrets, version: MQTTProtocolVersion, answer_s: float) -> Client:
    """Make a client that is ready to connect. It has no thread, and tries nothing by itself."""
    is_v5 = version == MQTTProtocolVersion.MQTTv5
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=f"{options.client_id}{secrets.client_suffix}",
        # A session of 3.1.1 never ends. We subscribe anew each time, so there is nothing to keep in it.
        clean_session=None if is_v5 else True,
        protocol=version,
        reconnect_on_failure=False,
    )
    client.connect_timeout = answer_s
    client.on_socket_open = _send_at_once
    if options.username is not None:
        client.username_pw_set(options.username, secrets.password)
    if secrets.tls is not None:
        client.tls_set_context(secrets.tls)
    _set_session(client, options, is_v5=is_v5)
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


def _set_session(client: Client, options: MqttSettings, *, is_v5: bool) -> None:
    session, will = None, None
    if is_v5:
        session = _properties(PacketTypes.CONNECT, SessionExpiryInterval=SESSION_EXPIRY_S, MaximumPacketSize=PACKET_MAX)
        will = _properties(PacketTypes.WILLMESSAGE, WillDelayInterval=WILL_DELAY_S)
    client.will_set(f"{options.base}/{OFFLINE.topic}", OFFLINE.payload, OFFLINE.qos, OFFLINE.retain, will)
    client.connect_async(
        options.host, options.broker_port, keepalive=KEEPALIVE_S, clean_start=False, properties=session
    )


def _properties(packet_type: int, **values: int | str | bytes) -> Properties:
    properties = Properties(packet_type)  # type: ignore[no-untyped-call] # paho has not typed it
    for name, value in values.items():
        setattr(properties, name, value)
    return properties


# The files that the configuration names: the password, certificates and keys -----------------------


def read_secrets(options: MqttSettings) -> Secrets:
    """Read the files that the configuration names; raises `DeviceOpenError` for one that is of no use."""
    password = _read_password(options.password_file) if options.password_file else None
    tls = _tls_context(options) if options.tls else None
    known = password.encode() if password is not None else b""
    if tls is not None and (key_file := options.key_file or options.certificate_file) is not None:
        known = read_untrusted(key_file, CERTIFICATES_MAX_BYTES)
    return Secrets(password=password, tls=tls, client_suffix=_client_suffix(known, options.client_id))


def _client_suffix(known: bytes, client_id: str) -> str:
    """Make a suffix of a secret that tells nothing of it: a broker logs client ids. Takes 10 ms on a PC."""
    if not known:
        return ""
    return "-" + hashlib.scrypt(known, salt=client_id.encode(), n=4096, r=8, p=1, dklen=6).hex()


def _read_password(file: Path) -> str:
    try:
        lines = read_untrusted_text(file, SECRET_MAX_BYTES).splitlines()
    except UnreadableError as error:
        raise DeviceOpenError(f"password_file {file} cannot be read: {error.reason}") from error
    if not lines or not lines[0]:
        raise DeviceOpenError(f"password_file {file} has no password on its first line")
    return lines[0]


def _tls_context(options: MqttSettings) -> ssl.SSLContext:
    context = _trusting(options.ca_file)
    if options.certificate_file is not None:
        _identify(context, options.certificate_file, options.key_file)
    context.sslsocket_class = _TidySocket
    return context


def _identify(context: ssl.SSLContext, certificate_file: Path, key_file: Path | None) -> None:
    def refuse_passphrase() -> str:
        raise DeviceOpenError(f"key_file {key_file} needs a passphrase, and no person is there to type it; remove it")

    try:
        context.load_cert_chain(certificate_file, key_file, refuse_passphrase)
    except ssl.SSLError as error:
        reason = f"is of no use with key_file {key_file} ({error.reason or error})"
        raise DeviceOpenError(f"certificate_file {certificate_file} {reason}") from error
    except OSError as error:
        raise DeviceOpenError(
            f"certificate_file {certificate_file} or key_file {key_file} cannot be read: {error.strerror or error}"
        ) from error


def _trusting(ca_file: Path | None) -> ssl.SSLContext:
    try:
        # Remarks between the certificates may be in any alphabet.
        text = read_untrusted(ca_file, CERTIFICATES_MAX_BYTES).decode("ascii", "ignore") if ca_file else None
        return ssl.create_default_context(cadata=text)
    except UnreadableError as error:
        raise DeviceOpenError(f"ca_file {ca_file} cannot be read: {error.reason}") from error
    except (ssl.SSLError, ValueError) as error:
        reason = getattr(error, "reason", None) or str(error)
        raise DeviceOpenError(f"ca_file {ca_file} holds no certificate that can be used ({reason})") from error


class _TidySocket(ssl.SSLSocket):
    """Closes itself when the handshake fails, which paho leaves to the garbage collector."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise


# The events of a connection to a broker, as paho reports them, and their messages for people ------


# A connection that ends sooner is not taken for a sign that all is well.
STABLE_S = 10.0

# After this many connections in a row that ended soon, two programs with one name are suspected.
SUSPICIOUS = 3


class LinkEvents:
    """Collects the events of paho's callbacks, without a lock.

    All callbacks come in the link's thread, within paho's loop, and so does every call here, save that `refusal` may
    be read by any thread.

    Attributes:
        ending: Why the newest attempt to connect failed, or the connection ended, in words.
        suspects_version: Whether the broker seems not to speak the version of MQTT that was tried.
        was_taken_over: Whether another program with our client id took our place.
        refusal: Why the broker would not take a message over this connection, in words.
        subscribed_at_s: When the broker answered our subscriptions, by the number of each.
        packet_max: The largest packet that the broker takes; None if it does not say.
        has_identifiers: Whether the broker marks messages with the subscription that they come from.

    Args:
        hear: Takes a message, within paho's loop.
    """

    def __init__(self, options: MqttSettings, hear: Callable[[MQTTMessage], None] = lambda _message: None) -> None:
        self._options = options
        self._hear = hear
        self._answered: deque[tuple[int, list[ReasonCode]]] = deque()
        self._done: deque[tuple[int, bool]] = deque()
        self._short_lives = 0
        self._was_ever_accepted = False
        self.refusal = ""
        self.begin()

    def begin(self) -> None:
        """Forget the last attempt to connect; another begins."""
        self.ending = ""
        self.suspects_version = False
        self.was_taken_over = False
        self.subscribed_at_s: dict[int | None, float] = {}
        self.packet_max: int | None = None
        self.has_identifiers = True
        self._answered.clear()
        self._accepted_at_s: float | None = None
        self._stood_s = 0.0

    @property
    def is_accepted(self) -> bool:
        """True if the broker accepted us in this attempt."""
        return self._accepted_at_s is not None

    @property
    def was_stable(self) -> bool:
        """True if the connection that ended had stood for a good while."""
        return self._stood_s > STABLE_S

    def listen_to(self, client: Client) -> None:
        """Have a client tell us."""
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message

    def note_connect_error(self, error: OSError) -> None:
        """Note that there is no connection at all."""
        self.ending = describe_connect_error(self._options, error)

    def note_no_answer(self) -> None:
        """Note that the broker took the connection and then said nothing."""
        self.ending = describe_silence(self._options, had_answered=False)
        self.suspects_version = not self._was_ever_accepted

    def note_nonsense(self) -> None:
        """Note that the other side sent what is not MQTT."""
        self.ending = describe_non_mqtt(self._options)
        self.suspects_version = not self._was_ever_accepted

    def note_unsendable(self, topic: str, error: ValueError) -> None:
        """Note that a message cannot be packed, such as one whose text is no Unicode."""
        self.refusal = f"a message for '{topic[:200]}' cannot be sent: {error}"

    def take_done(self) -> Iterator[tuple[int, bool]]:
        """Yield, once each, the messages that were written (QoS 0) or answered (QoS 1): number, and if refused."""
        while self._done:
            yield self._done.popleft()

    def take_subscribed(self) -> Iterator[tuple[int, list[ReasonCode]]]:
        """Yield, once each, the broker's answers to subscriptions to requests: number, and a code for each topic."""
        while self._answered:
            yield self._answered.popleft()

    def _on_connect(self, _client: Client, _data: Any, _flags: ConnectFlags, reason: ReasonCode, more: Any) -> None:
        if reason.is_failure:
            self.ending = describe_refusal(self._options, reason)
            self.suspects_version = reason.value == UNSUPPORTED_VERSION
            return
        self._accepted_at_s = time.monotonic()
        self._was_ever_accepted = True
        self.refusal = ""
        self.packet_max = getattr(more, "MaximumPacketSize", None)
        self.has_identifiers = bool(getattr(more, "SubscriptionIdentifierAvailable", 1))

    def _on_disconnect(
        self, _client: Client, _data: Any, flags: DisconnectFlags, reason: ReasonCode, _more: Any
    ) -> None:
        if self._accepted_at_s is not None:
            self._stood_s = time.monotonic() - self._accepted_at_s
            self._short_lives = 0 if self.was_stable else self._short_lives + 1
        if self.ending:
            return
        # Few brokers say that two programs take the connection from each other, and with MQTT 3.1.1 none can.
        guess = f" (does another program use the client id '{self._options.client_id}'?)"
        guess = guess if self._short_lives >= SUSPICIOUS else ""
        if flags.is_disconnect_packet_from_server:
            self.was_taken_over = reason.value == TAKEN_OVER
            place, client_id = self._options.place, self._options.client_id
            self.ending = f"{place} ended the connection ({reason}){guess}"
            if self.was_taken_over:
                self.ending = f"another program uses the client id '{client_id}' at {place}; give each its own node"
            return
        self.suspects_version = not self._was_ever_accepted
        self.ending = describe_loss(self._options, reason, had_answered=self.is_accepted) + guess

    def _on_publish(self, _client: Client, _data: Any, number: int, reason: ReasonCode, _more: Any) -> None:
        if reason.is_failure:
            place = self._options.discovery_place
            or_to = f" or to '{place.topic}'" if place is not None else ""
            below = f"a message below '{self._options.base}'{or_to} ({reason})"
            self.refusal = f"{self._options.place} refused {below}; check the broker's access list"
        self._done.append((number, reason.is_failure))

    def _on_subscribe(self, _client: Client, _data: Any, number: int, codes: list[ReasonCode], _more: Any) -> None:
        self.subscribed_at_s[number] = time.monotonic()
        self._answered.append((number, codes))

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        with suppress(UnicodeDecodeError):
            self._hear(message)


UNSUPPORTED_VERSION = 0x84
BAD_LOGIN = 0x86
NOT_AUTHORISED = 0x87
NO_MQTT = 0x82
KEEPALIVE = 0x8D
TAKEN_OVER = 0x8E


def describe_connect_error(options: MqttSettings, error: OSError) -> str:
    """Say why there is no connection at all, in one line."""
    place = options.place
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of {place} {not_trusted(error, options.host, 'name its authority in ca_file')}"
    if isinstance(error, socket.gaierror):
        return f"no address is known for the host '{options.host}' ({error.strerror})"
    if isinstance(error, ConnectionRefusedError):
        return f"{place} refused the connection (is a broker running there?)"
    return f"{place} {_trouble(error)}" + (" (is this its port for TLS?)" if options.tls else "")


def _trouble(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return "does not answer"
    if isinstance(error, ConnectionResetError):
        return "hung up without an answer"
    if isinstance(error, ssl.SSLError):
        return f"does not speak TLS as expected: {error.strerror or error}"
    return f"cannot be reached: {error.strerror or error}"


def describe_refusal(options: MqttSettings, reason: ReasonCode) -> str:
    """Say why the broker would not have us."""
    if reason.value in {NOT_AUTHORISED, BAD_LOGIN}:
        who = f"the login of '{options.username}'" if options.username else "a connection without a login"
        return f"{options.place} refused {who} ({reason}); check username and password_file"
    if reason.value == UNSUPPORTED_VERSION:
        return f"{options.place} does not speak MQTT {options.protocol}; set protocol to 'auto'"
    return f"{options.place} refused the client '{options.client_id}' ({reason})"


def describe_loss(options: MqttSettings, reason: ReasonCode, *, had_answered: bool) -> str:
    """Say how a connection ended without a word from the broker."""
    if reason.value == KEEPALIVE:
        return describe_silence(options, had_answered=had_answered)
    if reason.value == NO_MQTT:
        return describe_non_mqtt(options)
    if not had_answered:
        return f"{options.place} hung up without an answer (is it an MQTT broker, with TLS as configured?)"
    return f"the connection to {options.place} was lost"


def describe_non_mqtt(options: MqttSettings) -> str:
    """Say, in one line, that what was received is not MQTT."""
    return f"{options.place} does not answer as an MQTT broker does"


def describe_silence(options: MqttSettings, *, had_answered: bool) -> str:
    """Say that the broker says nothing."""
    return f"{options.place} has stopped answering" if had_answered else f"{options.place} does not answer"
