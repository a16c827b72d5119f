"""The object detector: whatever a neural network finds, such as a person or a face, by one length that is known of it.

The model file is the user's own. A network takes up to a second a picture on a small computer, so it looks only from
time to time, and in between the box is followed from picture to picture: `stadimeter.detectors.object.detector`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator, model_validator

from stadimeter.config.extras import missing
from stadimeter.config.files import is_file
from stadimeter.config.plugins import Count, DriverContext, DriverOptions, numbered
from stadimeter.config.units import Duration, FilePath, LengthWithSpread, SpreadLength
from stadimeter.detectors.object.detector import LoadedNetwork, ObjectDetector, ObjectSearch, SeveralObjects
from stadimeter.detectors.object.families import FAMILIES, FamilyName, recognise
from stadimeter.detectors.object.model_file import load_model
from stadimeter.detectors.object.network import USUAL_EVERY_S, EngineChoice, Network, examine
from stadimeter.detectors.protocol import NetworkReport
from stadimeter.errors import DriverError, UnreadableError
from stadimeter.ranging.flat import KnownLength, UprightShape

# Standard deviation of a length in the picture of a thing that is seen large, as a share of it. Boxes of people who
# stand erred by 0.02 (measured, see `stadimeter.detectors.object.families`); strides, stoops, hats and soles are taken
# to add 0.04. Distances of eyes erred by 0.06: the same face gives the same error in any picture.
BOX_SIGMA, EYES_SIGMA = 0.045, 0.06

# Lengths that there are, in metres: the height of a class, and the distance of two pupils.
PLAUSIBLE_M: Mapping[str, tuple[float, float]] = {"person": (0.4, 2.6), "eye_distance": (0.04, 0.08)}

_LENGTHS: tuple[KnownLength, ...] = ("height", "width", "eye_distance")


class ObjectOptions(DriverOptions):
    """The options of what a neural network finds, such as a person or a face."""

    model: FilePath | None = None
    """The network: an ONNX file; None for the one that the camera runs on its sensor (``network`` in ``[camera]``)."""
    family: Annotated[FamilyName | None, Field(validate_default=True)] = None
    """What its outputs mean: ``yolox``, ``yolov8`` (and 11), ``nanodet``, ``yunet`` or ``centerface``. Without it, what
    its file says decides."""
    class_name: Annotated[str | None, Field(alias="class", validate_default=True)] = None
    """What is looked for, by the name or the number that the network has for it; ``person`` or ``face`` without it."""
    height: LengthWithSpread | None = None
    """How tall it is, such as ``"1.72 m ± 7 cm"``: the mean, and one standard deviation among all."""
    width: LengthWithSpread | None = None
    """How wide it is, instead of the height."""
    eye_distance: LengthWithSpread | None = None
    """Of faces, how far apart the pupils are, such as ``"63 mm ± 3.5 mm"``."""
    min_score: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """Boxes of which the network is less sure than this are not accepted."""
    every: Duration = USUAL_EVERY_S
    """The network looks once in this time of capture at most. In between its box is followed."""
    box_sigma: Annotated[float, Field(gt=0, le=0.3)] | None = None
    """Standard deviation of the length in the picture, as a share, of what is seen large: 0.045 for boxes, 0.06 for
    eyes. In few pixels it is more."""
    count: Count | None = None
    """How many there are at most, each a target of its own; None for one."""
    input_px: Annotated[int, Field(ge=64, le=2048)] | None = None
    """The longer side of the picture that the network sees, where its file leaves that open."""
    engine: EngineChoice = "auto"
    """What runs it: ``opencv``, ``onnxruntime``, or ``auto`` for the latter where it is installed."""

    @field_validator("model")
    @classmethod
    def _is_network(cls, path: Path) -> Path:
        try:
            return load_model(path).path if is_file(path) else path
        except (UnreadableError, ValueError) as error:
            raise ValueError(f"{path}: {error.reason if isinstance(error, UnreadableError) else error}") from error

    @field_validator("family")
    @classmethod
    def _is_of_family(cls, name: FamilyName | None, info: ValidationInfo) -> FamilyName | None:
        if (path := info.data.get("model")) is not None and is_file(path):
            try:
                recognise(load_model(path), name)
            except ValueError as error:
                raise ValueError(f"{path}: {error}; `stadimeter doctor models {path}` says what it is") from error
        return name

    @field_validator("class_name")
    @classmethod
    def _has_class(cls, value: str | None, info: ValidationInfo) -> str | None:
        path = info.data.get("model")
        if path is not None and "family" in info.data and is_file(path):
            recognise(load_model(path), info.data["family"]).number_of(value)
        return value

    @field_validator(*_LENGTHS)
    @classmethod
    def _is_plausible(cls, value: SpreadLength | None, info: ValidationInfo) -> SpreadLength | None:
        if info.field_name != "eye_distance" and "class_name" not in info.data:  # it is wrong itself
            return value
        what = "eye_distance" if info.field_name == "eye_distance" else info.data.get("class_name") or "person"
        if value is None or what not in PLAUSIBLE_M or info.field_name == "width":
            return value
        low_m, high_m = PLAUSIBLE_M[what]
        if not low_m <= value.length_m <= high_m:
            one = "the distance of two pupils" if what == "eye_distance" else f"the height of a {what}"
            raise ValueError(f"{value.length_m:g} m is not {one}, which is {low_m:g} to {high_m:g} m; check the unit")
        return value

    @model_validator(mode="after")
    def _has_one_length(self) -> ObjectOptions:
        written = [name for name in _LENGTHS if getattr(self, name) is not None]
        if len(written) != 1:
            raise ValueError(
                f"{' and '.join(written)} are given; keep one of them"
                if written
                else "no size is given; write height, width or eye_distance, such as height = '1.72 m ± 7 cm'"
            )
        known = recognise(load_model(self.model), self.family) if self.model and is_file(self.model) else None
        if written == ["eye_distance"] and not (known.family.has_eyes if known else self.model):
            name = known.name if known else "a network on the sensor"
            faces = " and ".join(name for name, each in FAMILIES.items() if each.has_eyes)
            raise ValueError(f"eye_distance: {name} finds no eyes, {faces} do; write height or width")
        return self

    @property
    def members(self) -> tuple[str, ...]:
        """The numbers from 1 to `count`."""
        return numbered(self.count)

    def build(self, context: DriverContext) -> ObjectDetector:
        """Return the detector. The network is loaded with the first picture."""
        search = ObjectSearch(
            shape=self.shape,
            every_s=self.every,
            min_score=self.min_score,
            load=partial(self._load, context.name, self.model) if self.model else None,
            class_name=self.class_name or "person",
        )
        if self.count is None:
            return ObjectDetector(context.name, search)
        return SeveralObjects(context.name, search, self.count)

    def _load(self, name: str, model: Path) -> LoadedNetwork:
        try:
            known = recognise(load_model(model), self.family)
            number = known.number_of(self.class_name)
        except (UnreadableError, ValueError) as error:
            raise DriverError(f"the model of target '{name}' cannot be used: {error}") from error
        network = Network(known, self.engine, self.input_px)
        return LoadedNetwork(network=network, number=number, what=known.classes[number])

    def lacks(self) -> tuple[str, ...]:
        """Return that the model file or the engine is missing."""
        is_there = self.model is None or is_file(self.model)
        file = () if is_there else (f"the model file {self.model} is not there; a run would stop",)
        engine = missing("network") if self.engine == "onnxruntime" else ""
        return (*file, *([engine] if engine else []))

    @property
    def shape(self) -> UprightShape:
        """The known length."""
        known = next(name for name in _LENGTHS if getattr(self, name) is not None)
        length: SpreadLength = getattr(self, known)
        return UprightShape(
            known=known,
            length_m=length.length_m,
            relative_sigma=length.sigma_m / length.length_m,
            box_sigma=self.box_sigma or (EYES_SIGMA if known == "eye_distance" else BOX_SIGMA),
        )

    @staticmethod
    def examine_network(path: Path) -> NetworkReport:
        """Say what a model file is, and how fast it runs here."""
        return examine(path)
