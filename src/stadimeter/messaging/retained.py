"""What a broker keeps of a run, written down at the broker itself: a later run clears what it no longer publishes.

The list is beside what it lists, so it is there whenever that is: whatever became of this computer, its state file or
its configuration's name. A broker that forgets one forgets the other.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator

from stadimeter.core.message import Message, clearing

# No more is read of a list, nor written: that many pages hold over a thousand rules.
PAGES_MAX = 200

# Topics of the program that are no rule's; see `stadimeter.config.rules.sequence_tables.OWN_TOPICS`.
_OF_RULE = re.compile(r"rule/[^/]+/(?:state|availability)")
_OWN = re.compile(r"(?:availability|event|retained|rule|target)(?:/.*)?", re.DOTALL)


class RetainedList:
    """The topics whose messages a broker keeps of this node, as pages of JSON that are small enough to be read back.

    It does no I/O and knows no clock. What the pages say is not trusted: whatever they name, nothing is cleared but
    states of rules and messages of the user's own, below the base topic.

    Args:
        topic: Where the pages are, below the base topic; each adds its number.
        room_bytes: The size of a page.
    """

    def __init__(self, topic: str, room_bytes: int) -> None:
        self._topic = topic
        self._room_bytes = room_bytes
        self._topics: frozenset[str] | None = None
        self._pages: dict[int, str] = {}
        self._is_read = False

    @property
    def is_wanted(self) -> bool:
        """Whether it is known what this run publishes, so that the pages can be compared with it."""
        return self._topics is not None and self._room_bytes > 0

    def begin(self) -> None:
        """Forget the pages: they are read again over a new connection."""
        self._pages, self._is_read = {}, False

    def hear(self, number: str, payload: bytes) -> None:
        """Take in a page that the broker has kept; what can be none is passed over."""
        if not self._is_read and number.isascii() and number.isdecimal() and len(number) < 4 and payload:
            self._pages[int(number)] = payload.decode("utf-8", "replace")

    def finish(self) -> tuple[Message, ...]:
        """Return what is to be sent when all pages are read: what clears topics that are gone, then the new pages."""
        if self._topics is None:
            return ()
        self._is_read = True
        listed = {topic for page in self._pages.values() for topic in _topics_of(page)}
        return (*clearing(listed - self._topics), *self._rewritten(self._topics))

    def retain_only(self, topics: frozenset[str]) -> tuple[Message, ...]:
        """Take on what is published from now on; return the pages that change, to be sent after what clears topics."""
        self._topics = topics
        return tuple(self._rewritten(topics)) if self._is_read else ()

    def _rewritten(self, topics: frozenset[str]) -> Iterator[Message]:
        before, self._pages = self._pages, dict(enumerate(_paged(sorted(topics), self._room_bytes)))
        for number in sorted(before.keys() | self._pages.keys()):
            page = self._pages.get(number, "")
            if page != before.get(number):
                yield Message(topic=f"{self._topic}/{number}", payload=page, qos=1, retain=True)


def _paged(topics: Iterable[str], room_bytes: int) -> list[str]:
    """Divide topics into JSON lists; one that is too long for a page, or comes after the last, is left out."""
    pages: list[list[str]] = []
    left_bytes = 0
    for topic in topics:
        size = len(json.dumps(topic)) + 1  # in ASCII, with its comma
        if size + 1 > room_bytes:
            continue
        if size > left_bytes:
            pages.append([])
            left_bytes = room_bytes - 1
        pages[-1].append(topic)
        left_bytes -= size
    return [json.dumps(page, separators=(",", ":")) for page in pages[:PAGES_MAX]]


def _topics_of(page: str) -> Iterator[str]:
    """Yield the topics of a page that may be cleared."""
    try:
        found = json.loads(page)
    except (ValueError, RecursionError):
        return
    for topic in found if isinstance(found, list) else ():
        is_topic = isinstance(topic, str) and topic.isprintable() and not re.search(r"[+#]", topic) and topic.strip("/")
        if is_topic and (_OF_RULE.fullmatch(topic) or not _OWN.fullmatch(topic)):
            yield topic
