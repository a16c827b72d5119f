"""Small drivers with one mistake each, under the contract suites. `test_contracts_catch_mistakes.py` runs this file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

import pytest
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.decision import first_to_go
from stadimeter.core.message import Message
from stadimeter.core.notification import Notification
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError, LinkLostError
from stadimeter.testing.actuator_contract import ABSENT, FAILS, ActuatorContract, ActuatorRig, ButtonContract, ButtonRig
from stadimeter.testing.base_contract import SILENT, TAKES_NO_BYTES, UNPLUGGED, BaseContract, BaseRig
from stadimeter.testing.messaging_contract import GONE, MessengerContract, MessengerRig, NotifierContract, NotifierRig
from stadimeter.testing.messaging_contract import SILENT as NO_ANSWER
from stadimeter.testing.rig import ManualClock, impossible

STEPS = 10


class VendorError(Exception):
    """What the vendor's library raises."""


class Chip(Struct):
    """The vendor's library with a lamp of ten steps behind it, and who holds it."""

    step: int = 0
    handles: int = 0
    is_absent: bool = False
    is_failing: bool = False

    def take(self) -> None:
        if self.is_absent:
            raise VendorError("no such chip")
        self.handles += 1

    def free(self) -> None:
        self.handles -= 1

    def write(self, step: int) -> None:
        if self.is_failing:
            raise VendorError("the chip does not answer")
        self.step = step

    def read(self) -> int:
        if self.is_failing:
            raise VendorError("the chip does not answer")
        return self.step


class SoundLamp:
    """A lamp without a mistake."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        self.is_open = False

    def open(self) -> None:
        if self.is_open:
            return
        try:
            self.chip.take()
        except VendorError as error:
            raise DeviceOpenError(f"lamp: {error}") from error
        self.is_open = True
        try:
            self.write(0)
        except DriverError as error:
            self.release()
            raise DeviceOpenError(str(error)) from error

    def apply(self, command: LevelCommand) -> LevelCommand:
        step = round(command.level * STEPS)
        self.write(step)
        return replace(command, level=step / STEPS)

    def tick(self, now_s: float) -> None:
        self.check_open()

    def stop(self) -> None:
        if self.is_open:
            self.write(0)

    def close(self) -> None:
        try:
            self.stop()
        finally:
            self.release()

    def release(self) -> None:
        if self.is_open:
            self.is_open = False
            self.chip.free()

    def check_open(self) -> None:
        if not self.is_open:
            raise DeviceClosedError("lamp: it is not open")

    def write(self, step: int) -> None:
        self.check_open()
        try:
            self.chip.write(step)
        except VendorError as error:
            raise DriverError(f"lamp: {error}") from error


class ReportsWhatWasAsked(SoundLamp):
    def apply(self, command: LevelCommand) -> LevelCommand:
        super().apply(command)
        return command if command.level >= 0.1 else replace(command, level=0.0)


class ReportsAnotherLevel(SoundLamp):
    def apply(self, command: LevelCommand) -> LevelCommand:
        applied = super().apply(command)
        return replace(applied, level=min(1.0, applied.level * 1.5))


class LetsTheVendorsErrorThrough(SoundLamp):
    def write(self, step: int) -> None:
        self.check_open()
        self.chip.write(step)


class LetsTheVendorsErrorThroughWhenOpened(SoundLamp):
    def open(self) -> None:
        if not self.is_open:
            self.chip.take()
            self.is_open = True
            SoundLamp.write(self, 0)


class HidesTheVendorsError(SoundLamp):
    def write(self, step: int) -> None:
        self.check_open()
        try:
            self.chip.write(step)
        except VendorError:
            raise DriverError("lamp: failed") from None


class SwallowsTheVendorsError(SoundLamp):
    def write(self, step: int) -> None:
        self.check_open()
        with suppress(VendorError):
            self.chip.write(step)


class TakesThePinAgainWhenOpenedTwice(SoundLamp):
    def open(self) -> None:
        if self.is_open:
            self.chip.take()
        super().open()


class KeepsThePinWhenOpeningFails(SoundLamp):
    def open(self) -> None:
        if self.is_open:
            return
        try:
            self.chip.take()
            self.chip.write(0)
        except VendorError as error:
            raise DeviceOpenError(f"lamp: {error}") from error
        self.is_open = True


class KeepsThePinWhenClosingFails(SoundLamp):
    def close(self) -> None:
        if self.is_open:
            self.stop()
            self.release()


class TicksSlowly(SoundLamp):
    def tick(self, now_s: float) -> None:
        super().tick(now_s)
        time.sleep(0.3)


class TicksForEver(SoundLamp):
    def tick(self, now_s: float) -> None:
        super().tick(now_s)
        while True:
            time.sleep(0.1)


class TakesThePinInItsConstructor(SoundLamp):
    def __init__(self, chip: Chip) -> None:
        super().__init__(chip)
        self.chip.take()


class StaysOnWhenClosed(SoundLamp):
    def close(self) -> None:
        self.release()


class IgnoresUseWhenClosed(SoundLamp):
    def apply(self, command: LevelCommand) -> LevelCommand:
        return super().apply(command) if self.is_open else command


def lamp_rig(driver: type[SoundLamp]) -> ActuatorRig:
    chip = Chip()
    return ActuatorRig(
        device=driver(chip),
        clock=ManualClock(),
        output=lambda: chip.step / STEPS,
        is_held=lambda: chip.handles > 0,
        faults={
            ABSENT: lambda begins: setattr(chip, "is_absent", begins),
            FAILS: lambda begins: setattr(chip, "is_failing", begins),
        },
    )


@pytest.mark.parametrize("driver", [SoundLamp, *SoundLamp.__subclasses__()], ids=lambda each: each.__name__)
class TestLamps(ActuatorContract):
    @pytest.fixture
    def make_rig(self, driver: type[SoundLamp]) -> Callable[[], ActuatorRig]:
        return lambda: lamp_rig(driver)


class TestLampWhoseRigNamesNoFaults(ActuatorContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ActuatorRig]:
        return lambda: replace(lamp_rig(SoundLamp), faults={})


class SoundButton:
    """A button without a mistake: the chip is on its first step while somebody presses."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        self.is_open = False

    def open(self) -> None:
        if self.is_open:
            return
        try:
            self.chip.take()
        except VendorError as error:
            raise DeviceOpenError(f"button: {error}") from error
        self.is_open = True

    def is_pressed(self) -> bool:
        if not self.is_open:
            raise DeviceClosedError("button: it is not open")
        try:
            return self.chip.read() > 0
        except VendorError as error:
            raise DriverError(f"button: {error}") from error

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self.chip.free()


class ReadsUpsideDown(SoundButton):
    def is_pressed(self) -> bool:
        return not super().is_pressed()


class SaysItOnce(SoundButton):
    was_pressed = False

    def is_pressed(self) -> bool:
        was_pressed, self.was_pressed = self.was_pressed, super().is_pressed()
        return self.was_pressed and not was_pressed


class IsReadWhenClosed(SoundButton):
    def is_pressed(self) -> bool:
        return super().is_pressed() if self.is_open else False


class LetsTheChipsErrorThrough(SoundButton):
    def is_pressed(self) -> bool:
        return self.chip.read() > 0 if self.is_open else super().is_pressed()


class BelievesThatNobodyPresses(SoundButton):
    def is_pressed(self) -> bool:
        try:
            return super().is_pressed()
        except DeviceClosedError:
            raise
        except DriverError:
            return False


class HoldsTheChipTwice(SoundButton):
    def open(self) -> None:
        if self.is_open:
            self.chip.take()
        super().open()


def button_rig(driver: type[SoundButton]) -> ButtonRig:
    chip = Chip()
    return ButtonRig(
        device=driver(chip),
        press=lambda is_down: setattr(chip, "step", int(is_down)),
        is_held=lambda: chip.handles > 0,
        faults={
            ABSENT: lambda begins: setattr(chip, "is_absent", begins),
            FAILS: lambda begins: setattr(chip, "is_failing", begins),
        },
    )


@pytest.mark.parametrize("driver", [SoundButton, *SoundButton.__subclasses__()], ids=lambda each: each.__name__)
class TestButtons(ButtonContract):
    @pytest.fixture
    def make_rig(self, driver: type[SoundButton]) -> Callable[[], ButtonRig]:
        return lambda: button_rig(driver)


class Line(Struct):
    """A serial line with a robot behind it that acknowledges each command, in steps of 1 cm/s and 0.01 rad/s."""

    is_unplugged: bool = False
    is_silent: bool = False
    is_full: bool = False
    holders: int = 0
    motion: tuple[float, float] = (0.0, 0.0)
    answers: list[bytes] = field(default_factory=list)

    def write(self, linear: int, angular: int) -> None:
        if self.is_unplugged:
            raise OSError("no such device")
        if self.is_full:
            raise OSError("would block")
        if not self.is_silent:
            self.motion = (linear / 100, angular / 100)
            self.answers.append(b"OK")

    def read(self) -> list[bytes]:
        if self.is_unplugged:
            raise OSError("no such device")
        heard, self.answers = self.answers, []
        return heard


class SoundBase:
    """A base without a mistake."""

    def __init__(self, line: Line, clock: ManualClock) -> None:
        self.line = line
        self.clock = clock
        self.is_open = False
        self.waiting_since_s: float | None = None

    def open(self) -> None:
        if self.is_open:
            return
        self.take()
        try:
            self.greet()
        except LinkLostError as error:
            self.release()
            raise DeviceOpenError(str(error)) from error

    def take(self) -> None:
        self.line.holders += 1
        self.is_open, self.waiting_since_s = True, None

    def greet(self) -> None:
        self.line.answers.clear()
        self.send(0, 0)
        self.clock.advance_s(0.1)
        self.read()
        if self.waiting_since_s is not None:
            raise LinkLostError("base: it does not answer")

    def apply(self, command: TwistCommand) -> TwistCommand:
        linear, angular = round(100 * max(-0.5, min(0.5, command.linear_mps))), round(100 * command.angular_radps)
        self.send(linear, angular)
        return replace(command, linear_mps=linear / 100, angular_radps=angular / 100, tilt_radps=0.0)

    def tick(self, now_s: float) -> None:
        self.check_open()
        self.read()
        self.check_silence(now_s)

    def stop(self) -> None:
        if self.is_open:
            self.send(0, 0)

    def close(self) -> None:
        try:
            self.stop()
        finally:
            self.release()

    def release(self) -> None:
        if self.is_open:
            self.is_open = False
            self.line.holders -= 1

    def check_open(self) -> None:
        if not self.is_open:
            raise DeviceClosedError("base: it is not open")

    def check_silence(self, now_s: float) -> None:
        if self.waiting_since_s is not None and now_s - self.waiting_since_s > 0.3:
            raise LinkLostError("base: it has stopped answering")

    def send(self, linear: int, angular: int) -> None:
        self.check_open()
        try:
            self.line.write(linear, angular)
        except OSError as error:
            raise LinkLostError(f"base: {error}") from error
        if self.waiting_since_s is None:
            self.waiting_since_s = self.clock.now_s()

    def read(self) -> None:
        try:
            if self.line.read():
                self.waiting_since_s = None
        except OSError as error:
            raise LinkLostError(f"base: {error}") from error


class NeverNoticesSilence(SoundBase):
    def check_silence(self, now_s: float) -> None:
        pass


class OpensWithoutAnAnswer(SoundBase):
    def greet(self) -> None:
        self.send(0, 0)


class LetsOsErrorsThrough(SoundBase):
    def read(self) -> None:
        if self.line.read():
            self.waiting_since_s = None


class ReportsTheSpeedThatWasAsked(SoundBase):
    def apply(self, command: TwistCommand) -> TwistCommand:
        applied = super().apply(command)
        return applied if abs(command.linear_mps) > 0.5 else command


class ReportsATiltThatItHasNot(SoundBase):
    def apply(self, command: TwistCommand) -> TwistCommand:
        return replace(super().apply(command), tilt_radps=command.tilt_radps)


class TakesThePortAgainWhenOpenedTwice(SoundBase):
    def open(self) -> None:
        if self.is_open:
            self.line.holders += 1
        super().open()


class KeepsThePortWhenTheLinkIsLost(SoundBase):
    def close(self) -> None:
        if self.is_open:
            self.stop()
            self.release()


class DrivesOnWhenClosed(SoundBase):
    def close(self) -> None:
        self.release()


class WaitsForEachAnswer(SoundBase):
    def apply(self, command: TwistCommand) -> TwistCommand:
        time.sleep(0.2)
        return super().apply(command)


def base_rig(driver: type[SoundBase]) -> BaseRig:
    clock, line = ManualClock(), Line()
    return BaseRig(
        device=driver(line, clock),
        clock=clock,
        is_held=lambda: line.holders > 0,
        motion=lambda: line.motion,
        faults={
            UNPLUGGED: lambda begins: (setattr(line, "is_unplugged", begins), setattr(line, "motion", (0.0, 0.0)))[0],
            SILENT: lambda begins: setattr(line, "is_silent", begins),
            TAKES_NO_BYTES: lambda begins: setattr(line, "is_full", begins),
        },
    )


@pytest.mark.parametrize("driver", [SoundBase, *SoundBase.__subclasses__()], ids=lambda each: each.__name__)
class TestBases(BaseContract):
    @pytest.fixture
    def make_rig(self, driver: type[SoundBase]) -> Callable[[], BaseRig]:
        return lambda: base_rig(driver)


class TestBaseThatCannotFail(BaseContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], BaseRig]:
        never = impossible("it is made of words")
        return lambda: replace(base_rig(SoundBase), faults={UNPLUGGED: never, SILENT: never, TAKES_NO_BYTES: never})


ItemT = TypeVar("ItemT", Message, Notification)


class Service(Struct, Generic[ItemT]):
    """The other side of a messenger or a notifier."""

    taken: list[ItemT] = field(default_factory=list)
    is_gone: bool = False
    is_silent: bool = False

    def faults(self) -> dict[str, Callable[[bool], None]]:
        """Return what begins and ends each of its faults."""
        return {
            GONE: lambda begins: setattr(self, "is_gone", begins),
            NO_ANSWER: lambda begins: setattr(self, "is_silent", begins),
        }

    def send(self, item: ItemT) -> bool:
        """Return whether the item was acknowledged."""
        if self.is_gone:
            raise OSError("connection refused")
        if not self.is_silent:
            self.taken.append(item)
        return not self.is_silent


class SoundSender(Generic[ItemT]):
    """What a messenger and a notifier have in common, without a mistake: a queue of 100, sent when it is looked at."""

    def __init__(self, service: Service[ItemT]) -> None:
        self.service = service
        self.is_open = False
        self.given_up = 0
        self.waiting: list[ItemT] = []

    def open(self) -> None:
        self.is_open = True

    def hand_over(self, item: ItemT) -> None:
        if not self.is_open:
            raise DeviceClosedError("it is not open")
        self.waiting.append(item)
        if len(self.waiting) > 100 and (last := first_to_go(each.severity for each in self.waiting)) is not None:
            del self.waiting[last]
            self.given_up += 1
        self.deliver()

    def deliver(self) -> bool:
        """Return whether the other side is there."""
        try:
            while self.is_open and self.waiting:
                if not self.service.send(self.waiting[0]):
                    return False
                del self.waiting[0]
        except OSError:
            return False
        return not (self.service.is_gone or self.service.is_silent)

    def undelivered(self) -> tuple[ItemT, ...]:
        self.deliver()
        return tuple(self.waiting)

    def trouble(self) -> str:
        return "" if self.is_open and self.deliver() else "the service is away"

    def close(self) -> None:
        self.deliver()
        self.is_open = False


class SoundMessenger(SoundSender[Message]):
    def publish(self, message: Message) -> None:
        if not self.is_open:
            raise DeviceClosedError("it is not open")
        if message.qos or self.deliver():
            self.hand_over(message)


class PublishesWaiting(SoundMessenger):
    def publish(self, message: Message) -> None:
        super().publish(message)
        if self.service.is_gone:
            time.sleep(0.2)


class RaisesWhenTheBrokerIsGone(SoundMessenger):
    def publish(self, message: Message) -> None:
        super().publish(message)
        if self.service.is_gone:
            raise OSError("connection refused")


class ForgetsWhatWasNotAcknowledged(SoundMessenger):
    def deliver(self) -> bool:
        is_there = super().deliver()
        if self.service.is_silent:
            self.waiting.clear()
        return is_there


class NeverNoticesThatTheBrokerIsGone(SoundMessenger):
    def trouble(self) -> str:
        return ""


class ForgetsWhatIsLeftWhenClosed(SoundMessenger):
    def close(self) -> None:
        super().close()
        self.waiting.clear()


class DropsTheOldestUncounted(SoundMessenger):
    def hand_over(self, item: Message) -> None:
        super().hand_over(item)
        self.given_up = 0


class LeavesAThread(SoundMessenger):
    def open(self) -> None:
        super().open()
        threading.Thread(target=time.sleep, args=(3.0,), daemon=True).start()


def messenger_rig(driver: type[SoundMessenger]) -> MessengerRig:
    service: Service[Message] = Service()
    messenger = driver(service)

    def delivered() -> list[tuple[str, str]]:
        messenger.deliver()
        return [(message.topic, message.payload) for message in service.taken]

    return MessengerRig(
        device=messenger,
        delivered=delivered,
        faults=service.faults(),
        patience_s=0.2,
    )


@pytest.mark.parametrize("driver", [SoundMessenger, *SoundMessenger.__subclasses__()], ids=lambda each: each.__name__)
class TestMessengers(MessengerContract):
    @pytest.fixture
    def make_rig(self, driver: type[SoundMessenger]) -> Callable[[], MessengerRig]:
        return lambda: messenger_rig(driver)


class SoundNotifier(SoundSender[Notification]):
    def notify(self, notification: Notification) -> None:
        self.hand_over(notification)


class NotifiesWaiting(SoundNotifier):
    def notify(self, notification: Notification) -> None:
        super().notify(notification)
        if self.service.is_silent:
            time.sleep(0.2)


class BelievesThatEverythingWasTaken(SoundNotifier):
    def deliver(self) -> bool:
        is_there = super().deliver()
        self.waiting.clear()
        return is_there


class TellsItsAddress(SoundNotifier):
    def trouble(self) -> str:
        words = super().trouble()
        return words and f"https://user:secret@example.com: {words}"


class RaisesWhenTheServiceIsGone(SoundNotifier):
    def notify(self, notification: Notification) -> None:
        super().notify(notification)
        if self.service.is_gone:
            raise OSError("connection refused")


def notifier_rig(driver: type[SoundNotifier]) -> NotifierRig:
    service: Service[Notification] = Service()
    notifier = driver(service)

    def delivered() -> list[tuple[str, str]]:
        notifier.deliver()
        return [(each.title, each.body) for each in service.taken]

    return NotifierRig(
        device=notifier,
        delivered=delivered,
        faults=service.faults(),
        patience_s=0.2,
    )


@pytest.mark.parametrize("driver", [SoundNotifier, *SoundNotifier.__subclasses__()], ids=lambda each: each.__name__)
class TestNotifiers(NotifierContract):
    @pytest.fixture
    def make_rig(self, driver: type[SoundNotifier]) -> Callable[[], NotifierRig]:
        return lambda: notifier_rig(driver)
