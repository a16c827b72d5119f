"""The link to the workbench process: whatever that does, the page has an answer or a sentence."""

import asyncio
import sys

import pytest

from stadimeter.errors import PageError
from stadimeter.web.links import WAITING_MAX, WorkbenchLink, command_of_workbench

ODD = """
import json, os, sys, time
for line in sys.stdin:
    asked = json.loads(line)
    if asked["op"] == "die":
        os._exit(3)
    if asked["op"] == "hang":
        time.sleep(600)
    if asked["op"] == "babble":
        print("no JSON", flush=True)
    elif asked["op"] == "refuse":
        print(json.dumps({"status": "error", "error": "no", "code": "conflict", "their_text": "a"}), flush=True)
    else:
        answer = {"status": "ok", "data": [os.getpid(), asked["args"]], "bytes": 3}
        print(json.dumps(answer) + "\\nabc", end="", flush=True)
"""
"""Stands for the process with all that may happen to it."""


def tell(story, command=(sys.executable, "-c", ODD), idle_max_s=60.0):
    """Run a story of a link, and return what it returns; at its end the process is gone."""

    async def begin():
        link = WorkbenchLink(command, idle_max_s)
        try:
            return await story(link)
        finally:
            process = link._process
            await link.close()
            assert process is None or process.returncode is not None

    return asyncio.run(begin())


def test_the_process_is_started_once_and_answers_with_bytes():
    async def story(link):
        return [await link.ask("echo", {"text": "é\n"}, 20) for _ in range(2)]

    first, second = tell(story)
    assert first.data[1] == {"text": "é\n"}
    assert first.attached == b"abc"
    assert first.data[0] == second.data[0]


@pytest.mark.parametrize(
    ("op", "wait_s", "code"),
    [("die", 20, "workbench-gone"), ("babble", 20, "workbench-gone"), ("hang", 0.1, "workbench-slow")],
)
def test_after_a_mishap_there_is_a_sentence_and_then_another_process(op, wait_s, code):
    async def story(link):
        before = await link.ask("echo", {}, 20)
        with pytest.raises(PageError) as refused:
            await link.ask(op, {}, wait_s)
        assert (refused.value.status, refused.value.code) == (503, code)
        assert (await link.ask("echo", {}, 20)).data[0] != before.data[0]

    tell(story)


def test_a_refusal_keeps_its_code_and_what_else_it_says():
    async def story(link):
        with pytest.raises(PageError) as refused:
            await link.ask("refuse", {}, 20)
        return refused.value

    error = tell(story)
    assert (error.status, error.code, error.details) == (409, "conflict", {"their_text": "a"})


def test_the_answer_to_one_who_hung_up_is_not_the_next_ones():
    async def story(link):
        await link.ask("echo", {}, 20)
        gone = asyncio.ensure_future(link.ask("echo", {"of": "gone"}, 20))
        await asyncio.sleep(0)
        gone.cancel()
        return await link.ask("echo", {"of": "next"}, 20)

    assert tell(story).data[1] == {"of": "next"}


def test_no_more_wait_than_can_be_answered():
    async def story(link):
        asked = [asyncio.ensure_future(link.ask("echo", {"number": number}, 20)) for number in range(WAITING_MAX + 1)]
        return await asyncio.gather(*asked, return_exceptions=True)

    *answered, refused = tell(story)
    assert [answer.data[1]["number"] for answer in answered] == list(range(WAITING_MAX))
    assert refused.code == "busy"


def test_without_a_question_it_ends():
    async def story(link):
        await link.ask("echo", {}, 20)
        process = link._process
        assert await process.wait() == 0
        assert link._process is None or link._process is process

    tell(story, idle_max_s=0)


def test_a_command_that_is_not_there_is_a_sentence():
    async def story(link):
        with pytest.raises(PageError, match="cannot be started"):
            await link.ask("echo", {}, 20)

    tell(story, command=["/no/such/command"])


def test_the_real_one_is_asked_and_refuses_what_it_does_not_know(tmp_path):
    async def story(link):
        with pytest.raises(PageError, match="there is no operation 'nothing'"):
            await link.ask("nothing", {}, 60)
        return await link.ask("setup_operations.state", {}, 60)

    told = tell(story, command_of_workbench(tmp_path / "room.toml", None)).data
    assert told["folder"] == str(tmp_path)
