"""Engines that run a network: OpenCV, which is always there, or ONNX Runtime, which is mostly faster."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.config.extras import install_line, require
from stadimeter.detectors.object.model_file import ModelFile
from stadimeter.errors import DriverError

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
