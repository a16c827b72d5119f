"""A network that is loaded: from a picture to boxes in it, and what `stadimeter doctor models` says of its file."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, Protocol

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.config.extras import install_line, require
from stadimeter.core.frame import Image
from stadimeter.detectors.object.families import (
    Boxes,
    NetworkFamily,
    Recognised,
    WantedClass,
    fit_picture,
    one_each,
    recognise,
)
from stadimeter.detectors.object.model_file import ModelFile, load_model
from stadimeter.detectors.protocol import EngineTiming, NetworkReport
from stadimeter.errors import DriverError

# Engines that run a network: OpenCV, which is always there, or ONNX Runtime, which is mostly faster ---

Blob = NDArray[np.float32]
EngineName = Literal["opencv", "onnxruntime"]
EngineChoice = Literal["auto", "opencv", "onnxruntime"]


class Engine(Protocol):
    """Runs one network."""

    def run(self, blob: Blob) -> Sequence[Blob]:
        """Return the outputs for one picture ``(1, 3, height, width)``, in the order of the file."""


def installed_engines() -> tuple[EngineName, ...]:
    """Return the engines of this computer, the one that ``auto`` takes first. Nothing is loaded."""
    return ("onnxruntime", "opencv") if find_spec("onnxruntime") else ("opencv",)


def open_engine(choice: EngineChoice, file: ModelFile) -> Engine:
    """Load a network.

    ``auto`` does not measure which engine is faster: another load of the computer would choose another one, and the
    last digits of its boxes differ, so that a replay would not give the same answers.

    Raises:
        DriverUnavailableError: The engine is not installed.
        DriverError: It cannot run this network.
    """
    name = installed_engines()[0] if choice == "auto" else choice
    if name == "opencv":
        return OpenCvEngine(file)
    require("network", "engine = 'onnxruntime'")
    return OnnxRuntimeEngine(file)


class OpenCvEngine:
    """OpenCV's own (`cv2.dnn`)."""

    def __init__(self, file: ModelFile) -> None:
        self._file = file
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(file.data, np.uint8))
        except cv2.error as error:
            raise _cannot_run("OpenCV", file, error, "onnxruntime may: " + install_line("network")) from error

    def run(self, blob: Blob) -> Sequence[Blob]:
        """Return the outputs."""
        try:
            self._net.setInput(blob, self._file.inputs[0].name)
            outputs = self._net.forward([each.name for each in self._file.outputs])
        except cv2.error as error:
            raise _cannot_run("OpenCV", self._file, error, "onnxruntime may: " + install_line("network")) from error
        return [np.asarray(each, np.float32) for each in outputs]


class OnnxRuntimeEngine:
    """ONNX Runtime, an optional library."""

    def __init__(self, file: ModelFile) -> None:
        import onnxruntime  # type: ignore[import-untyped] # noqa: PLC0415 - an optional library, 60 MB

        self._file = file
        options: Any = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # what is fatal only: a run writes its own messages
        # Threads that wait for the next picture must not keep the other cores busy.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        data = file.data if None not in file.input_size else file.of_any_size()
        try:
            self._session: Any = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no other base in common
            raise _cannot_run("ONNX Runtime", file, error, "engine = 'opencv' may") from error

    def run(self, blob: Blob) -> Sequence[Blob]:
        """Return the outputs."""
        try:
            outputs: Sequence[Blob] = self._session.run(
                [each.name for each in self._file.outputs], {self._file.inputs[0].name: blob}
            )
        except Exception as error:  # its errors have no other base in common
            raise _cannot_run("ONNX Runtime", self._file, error, "engine = 'opencv' may") from error
        return outputs


def _cannot_run(engine: str, file: ModelFile, error: Exception, remedy: str) -> DriverError:
    why = " ".join(str(error).split())[:200]
    return DriverError(f"{engine} cannot run {file.path}: {why}; {remedy}")


# A network with its engine: a picture goes in, boxes come out ---------------------------------------------------------

# Adults: NCD Risk Factor Collaboration, "A century of trends in adult human height", eLife 2016; N. A. Dodgson,
# "Variation and extrema of human interpupillary distance", Proc. SPIE 5291, 2004.
USUAL_HEIGHT, USUAL_EYES = "1.7 m ± 9 cm", "63.4 mm ± 3.8 mm"

# A network that takes more of `every` than this leaves too little time to follow its boxes; what that is by default.
BUSY_SHARE, USUAL_EVERY_S = 1 / 3, 0.5

# An engine is worth a line of its own from so much quicker on.
MUCH_QUICKER = 1.2

# Each engine runs the network this many times; the first one prepares what the others use.
TIMED_RUNS = 4


class Network:
    """A network in its engine.

    Raises:
        DriverError: The engine is missing, or cannot run it.
    """

    def __init__(self, known: Recognised, engine: EngineChoice, input_px: int | None = None) -> None:
        self._known = known
        self._engine = open_engine(engine, known.file)
        self._input_px = input_px

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the lengths of its boxes, in pixels of its input."""
        return self._known.family.sigma_px

    def input_px(self, image: Image) -> tuple[int, int]:
        """Return width and height of its input for a picture."""
        return self._known.input_for(image.shape[1], image.shape[0], self._input_px)

    def find(self, image: Image, number: int, min_score: float) -> Boxes:
        """Return the boxes of a class in a picture, one for each thing, the likeliest first.

        Raises:
            DriverError: The engine cannot run it, or it gives other outputs than its family does.
        """
        family = self._known.family
        width, height = self.input_px(image)
        fitted = fit_picture(image, width, height, family.fill)
        outputs = self._engine.run(to_blob(fitted.image, family))
        try:
            count = family.count_classes([each.shape for each in outputs], (height, width))
        except ValueError as error:
            name, size = self._known.name, f"{width}x{height}"
            raise DriverError(f"{self._known.file.path} is not of the family {name}: for {size} px {error}") from error
        if number >= count:
            raise DriverError(
                f"{self._known.file.path} gives {count} classes, not the {number + 1} that it should have"
            )
        found = family.decode(outputs, WantedClass(number, min_score, width, height))
        return one_each(fitted.in_picture(found))


def to_blob(image: Image, family: NetworkFamily) -> Blob:
    """Return a picture as the network wants to see it, shape ``(1, 3, height, width)``."""
    scale = 1.0 / family.spread[0]
    blob = np.asarray(cv2.dnn.blobFromImage(image, scale, mean=family.mean, swapRB=family.is_rgb), np.float32)
    # OpenCV divides all channels by one number.
    for channel, spread in enumerate(family.spread[1:], 1):
        if spread != family.spread[0]:
            blob[:, channel] *= np.float32(family.spread[0] / spread)
    return blob


def examine(path: Path) -> NetworkReport:
    """Examine a model file: what it is, and how fast each engine runs it; raises as `load_model` does."""
    file = load_model(path)
    said = NetworkReport(
        producer=file.producer, inputs=tuple(map(str, file.inputs)), outputs=tuple(map(str, file.outputs))
    )
    try:
        known = recognise(file, None)
    except ValueError as error:
        return replace(said, doubt=str(error))
    timings = tuple(_time(known, engine) for engine in installed_engines())
    return replace(said, family=known.name, classes=known.classes, timings=timings, table=_table(known, timings))


def _table(known: Recognised, timings: Sequence[EngineTiming]) -> dict[str, str]:
    """Return the table to write into a configuration: the first class, at the usual size, by the quickest engine."""
    table = {"detector": "object", "model": str(known.file.path), "family": known.name}
    table |= (
        {"eye_distance": USUAL_EYES} if known.family.has_eyes else {"class": known.classes[0], "height": USUAL_HEIGHT}
    )
    ran = sorted((each for each in timings if each.seconds is not None), key=lambda each: each.seconds or 0.0)
    if ran and (timings[0].seconds or math.inf) > MUCH_QUICKER * (ran[0].seconds or 0.0):
        table["engine"] = ran[0].engine
    took_s = ran[0].seconds or 0.0 if ran else 0.0
    return table | ({"every": f"{took_s / BUSY_SHARE:.1f} s"} if took_s > BUSY_SHARE * USUAL_EVERY_S else {})


def _time(known: Recognised, engine: EngineName) -> EngineTiming:
    picture = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    took_s = []
    try:
        network = Network(known, engine)
        for _ in range(TIMED_RUNS):
            began_s = time.perf_counter()
            network.find(picture, 0, 1.0)
            took_s.append(time.perf_counter() - began_s)
    except DriverError as error:
        return EngineTiming(engine=engine, trouble=str(error))
    return EngineTiming(engine=engine, seconds=min(took_s[1:]))
