"""The pictures that came lately, known again by a hash."""

from __future__ import annotations

# Pictures are remembered for this long, so that a cycle of up to 20 s is noticed: drivers cycle through 3 to 10
# buffers, senders through a recording. The number bounds the memory: 200 pictures a second, 0.7 MB.
REMEMBERED_S = 25.0
MAX_REMEMBERED = 5000
BREAK_S = 1.0


class SeenPictures:
    """Knows again the pictures of the last `REMEMBERED_S`. Breaks do not count: what came before them stays known."""

    def __init__(self) -> None:
        self._seen_at_s: dict[int, float] = {}  # by hash, the one that came last at the end
        self._watched_s = 0.0
        self._came_at_s = 0.0

    def note(self, hashed: int, now_s: float) -> bool:
        """Note that a picture came; return whether it came before."""
        self._watched_s += min(max(now_s - self._came_at_s, 0.0), BREAK_S)
        self._came_at_s = now_s
        seen = self._seen_at_s
        came_before = seen.pop(hashed, None) is not None
        seen[hashed] = self._watched_s
        while len(seen) > MAX_REMEMBERED or seen[next(iter(seen))] < self._watched_s - REMEMBERED_S:
            del seen[next(iter(seen))]
        return came_before

    def __contains__(self, hashed: int) -> bool:
        return hashed in self._seen_at_s

    def __len__(self) -> int:
        return len(self._seen_at_s)
