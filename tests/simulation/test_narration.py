"""What the world says is what happens in it."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from msgspec.structs import replace

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.simulation.world import AFTER, AFTER_S, BY_HAND, DURING, FaultKind, Narrator, StoryLine

STORY = [StoryLine.model_validate({"at": at, "say": say}) for at, say in (("10 s", "it comes"), ("2 s", "it rolls"))]


def test_the_story_goes_by_the_time_and_begins_again_with_the_path() -> None:
    narrator = Narrator(STORY, period_s=20.0)
    assert [narrator.words((), at_s, path_s=at_s) for at_s in (0.0, 2.0, 9.9, 10.0, 19.9, 21.0, 22.0)] == [
        "", "it rolls", "it rolls", "it comes", "it comes", "", "it rolls",
    ]  # fmt: skip


def test_a_line_is_said_only_while_the_ball_is_where_it_says() -> None:
    near = StoryLine.model_validate({"at": "12 s", "nearer": "1 m", "say": "it is close"})
    far = StoryLine.model_validate({"at": "14 s", "beyond": "3 m", "say": "it is far"})
    narrator = Narrator([*STORY, near, far], period_s=None)
    said = [narrator.words((), 15.0, path_s=15.0, distance_m=distance_m) for distance_m in (0.9, 1.1, 3.1)]
    assert said == ["it is close", "it comes", "it is far"]


def test_a_ball_that_a_hand_holds_is_not_said_to_be_on_its_path() -> None:
    assert Narrator(STORY, period_s=None).words((), 12.0, path_s=12.0, is_by_hand=True) == BY_HAND


def test_what_goes_wrong_is_said_while_it_lasts_and_shortly_after() -> None:
    narrator = Narrator(STORY, period_s=None)
    assert narrator.words(["hide-target"], 3.0) == DURING["hide-target"]
    assert narrator.words([], 4.0) == AFTER["hide-target"]
    assert narrator.words([], 4.0 + AFTER_S, path_s=8.0) == "it rolls"


@pytest.mark.parametrize("kind", list(FaultKind))
def test_a_fault_is_turned_on_and_off_by_its_name(make_run, kind: FaultKind) -> None:
    world = make_run().world
    world.toggle(kind.value)
    assert world.goes_wrong(kind.value)
    assert world.narration() == DURING[kind]
    world.toggle(kind.value)
    assert not world.goes_wrong(kind.value)
    assert world.narration() == AFTER[kind]


def demonstration() -> Loop:
    """Return a run of the demonstration with fewer and smaller pictures, and the same story."""
    configuration = demo_configuration()
    options = configuration.camera.options.model_copy(update={"rate": 10.0})
    drivers = {**configuration.drivers, ("camera",): replace(configuration.camera, options=options)}
    lens = configuration.camera_model.scaled_to(320, 240)
    return Loop(build(replace(configuration, drivers=drivers, camera_model=lens), speed=None))


@pytest.mark.long
@pytest.mark.parametrize(
    "presses",
    [((8.0, "freeze-camera"), (12.0, "freeze-camera")), ((7.5, "unplug-base"),), ((6.5, "hide-target"),)],
    ids=["frozen twice", "unplugged and left so", "hidden and left so"],
)
def test_whatever_a_person_makes_go_wrong_ends_and_the_ball_is_found_again(
    presses: Sequence[tuple[float, str]],
) -> None:
    loop = demonstration()
    world, waiting = loop.parts.world, list(presses)
    begun_s = world.now_s
    said: list[tuple[str, bool]] = []

    def watch(record: CycleRecord, _frame: object) -> None:
        if waiting and world.now_s - begun_s >= waiting[0][0]:
            world.toggle(waiting.pop(0)[1])
        said.append((world.narration(), record.decision.tracks[0].is_valid))

    loop.listeners.append(watch)
    loop.run(Limits(seconds=32.0))
    assert not any(world.state()["faults"].values())
    assert all(is_tracked for _, is_tracked in said[-30:]), "the ball is not found again"
    story = {words for words, _ in said if words not in {*DURING.values(), *AFTER.values()}}
    unseen = sum(not is_tracked for words, is_tracked in said if words in story)
    assert unseen <= 3, "the story goes on while the ball is not seen"


@pytest.mark.long
def test_in_the_demonstration_the_outputs_do_what_is_said_when_it_is_said() -> None:
    loop = demonstration()
    done: dict[str, list[dict[str, float]]] = {}

    def watch(record: object, _frame: object) -> None:
        applied = {
            command.output: getattr(command, "level", getattr(command, "linear_mps", 0.0)) for command in record.applied
        }  # type: ignore[attr-defined]
        done.setdefault(loop.parts.world.narration(), []).append(applied)  # type: ignore[union-attr]

    loop.listeners.append(watch)
    loop.run(Limits(seconds=50.0))
    (vibrates,) = [turns for words, turns in done.items() if "motor vibrates" in words]
    (buzzes,) = [turns for words, turns in done.items() if "buzzer sounds" in words]
    assert max(turn["motor"] for turn in vibrates) > 0.3
    assert max(turn["buzzer"] for turn in buzzes) == 1.0
    elsewhere = [turn for turns in done.values() if turns not in (vibrates, buzzes) for turn in turns]
    assert not any(turn.get("motor") or turn.get("buzzer") for turn in elsewhere)
    for fault in ("hide-target", "freeze-camera"):
        assert done[DURING[fault]][-1]["base"] == 0.0
        assert done[AFTER[fault]][-1]["base"] > 0.0
