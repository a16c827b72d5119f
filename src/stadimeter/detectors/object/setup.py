"""What the set-up asks about what a network finds."""

from __future__ import annotations

from stadimeter.detectors.setup_kinds import BY_NETWORK, SetupKind, SetupQuestion

_MODEL = (
    "a file in the format ONNX, such as yolox_nano.onnx: `stadimeter models check FILE` says what it finds, "
    "`stadimeter models fetch centerface` gets one for faces, and docs/objects.md lists others"
)
_SIZE = "the mean, and behind ± one standard deviation among all that may come"
_CLASS = "its name or number as `stadimeter models check FILE` lists it, such as dog"


def _model(what: str, ready: str = "") -> SetupQuestion:
    text = f"Which network finds {what}?"
    return SetupQuestion("model", text, lambda path: {"model": path}, ready, _MODEL, files="*.onnx")


def _size(text: str, key: str, ready: str, **fixed: str) -> SetupQuestion:
    return SetupQuestion("size", text, lambda size: {**fixed, key: size}, ready, f"{_SIZE}, such as {ready}")


def object_kinds() -> tuple[SetupKind, ...]:
    """Return people, faces, and whatever else a network has a class for."""
    person = _size("How tall are the people that may come?", "height", "1.70 m ± 9 cm", **{"class": "person"})
    face = _size("How far apart are the pupils of the eyes?", "eye_distance", "63.4 mm ± 3.8 mm")
    height = _size("How tall is it?", "height", "50 cm ± 5 cm")
    other = SetupQuestion("class", "Which thing of the network is it?", lambda name: {"class": name}, "dog", _CLASS)
    faces, any_ = _model("faces", "centerface.onnx"), "a dog, a car, or whatever else your network finds"
    return (
        SetupKind("person", "a person", (_model("people"), person), group=BY_NETWORK, rank=20),
        SetupKind("face", "a face, by the distance of the eyes", (faces, face), group=BY_NETWORK, rank=21),
        SetupKind("object", any_, (_model("it"), other, height), group=BY_NETWORK, rank=22),
    )
