"""A network between a sender of JPEG pictures and `MjpegStream`, packet by packet, on a clock that is stepped.

A camera writes a picture each period. Its bytes leave in packets of `MSS_BYTES` through a token bucket, and wait in the
queue of a router for it. Packets either end with pictures, as a sender that writes each at once makes them, or they
are full while bytes wait, as TCP makes them of what waits in its buffer.
"""

from __future__ import annotations

import math
import random
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import cv2

from stadimeter.cameras.capture_time import StreamTime
from stadimeter.cameras.mjpeg_stream import MjpegStream
from stadimeter.core.frame import SeenPictures

MSS_BYTES = 1448
HEADER_BYTES = 52
"""Of Ethernet's payload of 1,500 bytes; headers of IP and TCP take the rest of it and of the link."""

WAY_S = 0.02
MAX_AGE_S = 0.2
"""The frame age of `config/follow-ball.toml`: a robot drives on a picture for as long."""

LEARNT_S = 6.0
"""How long the link is three times as fast as the stream, before it becomes slow."""


class Network:
    """Bytes of a stream as they arrive.

    Args:
        share: Bandwidth as a part of what the pictures need, from `LEARNT_S` on.
        ends_packets: Whether packets end with pictures.
        bucket_bytes: What the token bucket lets through at once after a pause.
        jitter: How irregular the time of a packet on the link is.
    """

    def __init__(
        self,
        seed: int,
        *,
        share: float,
        ends_packets: bool,
        rate_hz: float = 30.0,
        picture_bytes: int = 20_000,
        bucket_bytes: int = 3000,
        jitter: float = 0.2,
        seconds: float = 30.0,
    ) -> None:
        self._rng = random.Random(seed)  # noqa: S311 - the same network for each seed
        self._share, self._ends_packets, self._period_s = share, ends_packets, 1 / rate_hz
        self._picture_bytes, self._bucket_bytes, self._jitter = picture_bytes, bucket_bytes, jitter
        self._pictures = round(seconds * rate_hz)

    def captured_at_s(self, number: int) -> float:
        """Return when a picture was captured."""
        return number * self._period_s

    def packets(self) -> Iterator[tuple[float, bytes]]:
        """Yield the arrival and the bytes of each packet."""
        free_s, tokens, filled_s = 0.0, float(self._bucket_bytes), 0.0
        waiting = bytearray()
        for number in range(self._pictures):
            written_s, next_s = self.captured_at_s(number), self.captured_at_s(number + 1)
            waiting += self._part(number)
            while waiting and (self._ends_packets or free_s < next_s):
                packet, waiting = bytes(waiting[:MSS_BYTES]), waiting[MSS_BYTES:]
                size, start_s = len(packet) + HEADER_BYTES, max(free_s, written_s)
                bytes_a_second = self._bytes_a_second(start_s)
                tokens = min(self._bucket_bytes, tokens + (start_s - filled_s) * bytes_a_second)
                waits_s = (
                    max(0.0, size - tokens) / bytes_a_second * self._rng.uniform(1 - self._jitter, 1 + self._jitter)
                )
                tokens, filled_s = max(0.0, tokens - size), start_s + waits_s
                free_s = filled_s + 1e-5
                yield free_s + WAY_S, packet

    def _bytes_a_second(self, at_s: float) -> float:
        needs = self._picture_bytes * (1 + HEADER_BYTES / MSS_BYTES) / self._period_s
        return needs * (3.0 if at_s < LEARNT_S else self._share)

    def _part(self, number: int) -> bytes:
        size = round(self._picture_bytes * self._rng.uniform(0.95, 1.05))
        jpeg = b"\xff\xd8" + number.to_bytes(4, "big") + bytes(size - 8) + b"\xff\xd9"
        return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)


class _Body:
    """The end of the network, with the clock that its reader waits by."""

    def __init__(self, network: Network) -> None:
        self.now_s = 0.0
        self.is_over = False
        self.response = SimpleNamespace(isclosed=lambda: False, close=lambda: None)
        self._packets = network.packets()
        self._next = next(self._packets, None)

    def read(self, wait_s: float) -> bytes | None:
        """Return what has arrived, or the next packet if it comes within the time."""
        if self._next is None or self._next[0] > self.now_s + wait_s:
            self.is_over = self._next is None
            self.now_s += wait_s
            return None
        self.now_s = max(self.now_s, self._next[0])
        found = deque[bytes]()
        while self._next is not None and self._next[0] <= self.now_s:
            found.append(self._next[1])
            self._next = next(self._packets, None)
        return b"".join(found)


def hand_on(
    sender: socket.socket,
    client: socket.socket,
    bytes_a_second: Callable[[], float],
    ended: threading.Event,
    *,
    ends_packets: bool,
) -> None:
    """Hand a stream on in real time, packet by packet, until its sender ends or that is asked for."""
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    waiting = b""
    while not ended.is_set() and (waiting or (waiting := sender.recv(MSS_BYTES))):
        end = waiting.find(b"--frame", 1) if ends_packets else -1
        packet, waiting = (waiting[:end], waiting[end:]) if end > 0 else (waiting, b"")
        client.sendall(packet)
        time.sleep((len(packet) + HEADER_BYTES) / bytes_a_second())


def pictures_over(network: Network, busy_s: float = 0.004) -> Iterator[tuple[float, float, float | None, str]]:
    """Yield capture, arrival, what is believed of the capture, and why it is not, of each picture that is taken.

    Args:
        busy_s: How long the reader decodes each.
    """
    body = _Body(network)
    stream = MjpegStream(cast(Any, body), "frame", b"", 5.0, SeenPictures(), lambda: body.now_s)
    stream_time, count = StreamTime(WAY_S), 0
    while stream.grab() and not body.is_over:
        before, count = count, round(stream.get(cv2.CAP_PROP_POS_FRAMES))
        arrived_s = body.now_s
        found_s = stream_time.captured_at_s(arrived_s, 0.0, count - before, has_begun=stream.has_begun)
        yield network.captured_at_s(count - 1), arrived_s, found_s, stream_time.why_late
        body.now_s += busy_s


def turns_for_s(network: Network, busy_s: float = 0.004) -> float:
    """Return for how long a robot at most follows what is gone, beyond the usual way of a picture."""
    worst_s = -math.inf
    for captured_s, _, found_s, _ in pictures_over(network, busy_s):
        if found_s is not None:
            worst_s = max(worst_s, found_s + MAX_AGE_S - captured_s)
    return worst_s
