"""What browsers that watch are given: the newest, and of what they missed the events and the distances."""

import asyncio
import json

import pytest

from stadimeter.errors import PageError
from stadimeter.web.links import PageAnswer
from stadimeter.web.page import SAMPLES_KEPT_S, Feed


class ScriptedRun:
    """A run as a feed sees it: what it says, and when it ends."""

    def __init__(self):
        self.subscriptions = 0
        self.open = 0
        self.says = asyncio.Queue()

    async def subscription(self, args):
        self.subscriptions += 1
        self.open += 1
        try:
            while True:
                said = await self.says.get()
                if isinstance(said, Exception):
                    raise said
                yield said
        finally:
            self.open -= 1


def snapshot(number, events=(), samples=(), started=1.0):
    """What the run says at a time: its events and distances are those since the time before."""
    data = {
        "n": number,
        "run": {"started_unix_s": started},
        "events": [{"number": each} for each in events],
        "samples": {"ball": [[at_s, 1.0, 0.1] for at_s in samples]},
    }
    return PageAnswer(data, b"jpeg %d" % number)


async def settle():
    for _ in range(20):
        await asyncio.sleep(0)


def told(message):
    data = json.loads(message.snapshot)
    return data["n"], [event["number"] for event in data["events"]], [at_s for at_s, *_ in data["samples"]["ball"]]


@pytest.fixture
def told_by(monkeypatch):
    """Return a function that runs a story of a run and a feed."""
    monkeypatch.setattr("stadimeter.web.page.RETRY_S", 0)

    def tell(story):
        async def begin():
            run = ScriptedRun()
            feed = Feed(run, "plain")
            await story(run, feed)
            feed.close()
            await settle()
            assert run.open == 0

        asyncio.run(begin())

    return tell


def test_whoever_comes_while_the_run_hangs_is_told_how_old_the_last_message_is(told_by, monkeypatch):
    now_s = [50.0]
    monkeypatch.setattr("stadimeter.web.page.time.monotonic", lambda: now_s[0])

    async def story(run, feed):
        early, late = feed.watch(), feed.watch()
        first = asyncio.ensure_future(anext(early))
        await settle()
        await run.says.put(snapshot(1))
        assert json.loads((await first).snapshot)["waited_s"] == 0.0
        now_s[0] += 7.5
        assert json.loads((await anext(late)).snapshot)["waited_s"] == 7.5
        for each in (early, late):
            await each.aclose()

    told_by(story)


def test_many_watch_and_the_run_is_asked_once(told_by):
    async def story(run, feed):
        watchers = [feed.watch() for _ in range(20)]
        first = [asyncio.ensure_future(anext(each)) for each in watchers]
        await settle()
        await run.says.put(snapshot(1, events=[7], samples=[0.1]))
        messages = [await each for each in first]
        assert run.subscriptions == 1
        assert all(told(message) == (1, [7], [0.1]) for message in messages)
        assert {message.picture for message in messages} == {b"jpeg 1"}
        for each in watchers:
            await each.aclose()
        await settle()
        assert run.open == 0

    told_by(story)


def test_who_is_slow_loses_pictures_and_neither_events_nor_distances(told_by):
    async def story(run, feed):
        quick, slow = feed.watch(), feed.watch()
        waiting = [asyncio.ensure_future(anext(each)) for each in (quick, slow)]
        for number in range(1, 6):
            await run.says.put(snapshot(number, events=[number], samples=[number / 10]))
            await settle()
            assert told(await waiting[0]) == (number, [number], [number / 10])
            waiting[0] = asyncio.ensure_future(anext(quick))
            await settle()
        assert told(await waiting[1]) == (1, [1], [0.1])
        assert told(await anext(slow)) == (5, [2, 3, 4, 5], [0.2, 0.3, 0.4, 0.5])
        waiting[0].cancel()

    told_by(story)


def test_who_comes_late_is_told_what_was_before(told_by):
    async def story(run, feed):
        early = feed.watch()
        for number in (1, 2, 3):
            await run.says.put(snapshot(number, events=[number], samples=[number]))
            await anext(early)
        assert told(await anext(feed.watch())) == (3, [1, 2, 3], [1, 2, 3])

    told_by(story)


def test_what_the_run_repeats_at_a_new_subscription_is_told_once(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        await run.says.put(snapshot(1, events=[1, 2], samples=[1, 2]))
        await anext(watcher)
        await run.says.put(PageError(503, "no-run", "the run has ended"))
        assert json.loads((await anext(watcher)).snapshot) == {"gone": "the run has ended", "code": "no-run"}
        await run.says.put(snapshot(9, events=[1, 2, 3], samples=[1, 2, 3]))
        assert told(await anext(watcher)) == (9, [3], [3])
        assert run.subscriptions == 2

    told_by(story)


def test_of_a_run_that_was_started_anew_all_is_told(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        await run.says.put(snapshot(1, events=[1, 2], samples=[100, 200]))
        await anext(watcher)
        await run.says.put(PageError(503, "no-run", "the run has ended"))
        await anext(watcher)
        await run.says.put(snapshot(1, events=[1], samples=[1], started=2.0))
        assert told(await anext(watcher)) == (1, [1], [1])

    told_by(story)


def test_what_is_remembered_is_bounded(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        for second in range(900):
            await run.says.put(snapshot(second, events=[second], samples=[float(second)]))
            await anext(watcher)
        number, events, samples = told(await anext(feed.watch()))
        assert (number, events) == (899, list(range(800, 900)))
        assert samples == [float(second) for second in range(round(899 - SAMPLES_KEPT_S), 900)]

    told_by(story)
