"""The options of an MQTT messenger."""

from __future__ import annotations

import re
import socket
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.plugins import Options
from stadimeter.config.units import Duration, FilePath

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


def _check_base_topic(topic: str | None) -> str | None:
    if topic is None:
        return None
    if not topic or topic[0] in "/$" or topic[-1] == "/" or re.search(r"[+#\s\x00]", topic):
        raise ValueError(
            f"{topic!r} is not a base topic; write it such as 'stadimeter/garage', without '+', '#' or spaces"
        )
    return topic


def _check_keepalive(seconds: float) -> float:
    if not 1 <= seconds <= 65_535:
        raise ValueError(f"{seconds:g} s is not a keepalive; choose from 1 s to 65535 s, such as '15 s'")
    return seconds


class MqttOptions(Options):
    """The table of an ``mqtt`` messenger.

    The password is never part of a configuration: configurations are shown, logged and shared. It stands in a file of
    its own, which may be a systemd credential.
    """

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
    keepalive: Annotated[Duration, AfterValidator(_check_keepalive)] = 15.0
    """After this time without a word the link is probed, and given up if nothing answers."""
    protocol: Literal["auto", "5", "3.1.1"] = "auto"
    """The version of MQTT. ``auto`` is 5, and 3.1.1 if the broker does not speak 5."""

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file is given without a username; give both or neither")
        if self.ca_file is not None and not self.tls:
            raise ValueError("ca_file is given without tls; write 'tls = true' to encrypt")
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
    def client_id(self) -> str:
        """Who we are to the broker. It knows only one client of a name at a time."""
        return f"stadimeter-{self.node}"
