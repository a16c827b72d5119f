"""What the set-up asks about what a network finds."""

from __future__ import annotations

from stadimeter.detectors.setup_kinds import BY_NETWORK, SetupKind, SetupQuestion


def _model(what: str, ready: str = "") -> SetupQuestion:
    return SetupQuestion(
        key="model",
        text=f"Which network finds {what}?",
        keys=lambda path: {"model": path},
        ready=ready,
        form=(
            "a file in the format ONNX, such as yolox_nano.onnx: `stadimeter models check FILE` says what it finds, "
            "`stadimeter models fetch centerface` gets one for faces, and docs/objects.md lists others"
        ),
        files="*.onnx",
    )


def _size(key: str, text: str, ready: str, **fixed: str) -> SetupQuestion:
    form = f"the mean, and behind ± one standard deviation among all that may come, such as {ready}"
    return SetupQuestion(text=text, keys=lambda size: {**fixed, key: size}, ready=ready, form=form)


def object_kinds() -> tuple[SetupKind, ...]:
    """Return people, faces, and whatever else a network has a class for."""
    person = _size("height", "How tall are the people that may come?", "1.70 m ± 9 cm", **{"class": "person"})
    face = _size("eye_distance", "How far apart are the pupils of the eyes?", "63.4 mm ± 3.8 mm")
    other = SetupQuestion(
        key="class",
        text="Which of the things that the network knows is meant?",
        keys=lambda name: {"class": name},
        ready="dog",
        form="its name or number as `stadimeter models check FILE` lists it, such as dog",
    )
    height = _size("height", "How tall is it?", "50 cm ± 5 cm")
    return (
        SetupKind(name="person", meaning="a person", questions=(_model("people"), person), group=BY_NETWORK, rank=20),
        SetupKind(
            name="face",
            meaning="a face, by the distance of the eyes",
            questions=(_model("faces", "centerface.onnx"), face),
            group=BY_NETWORK,
            rank=21,
        ),
        SetupKind(
            name="object",
            meaning="a dog, a car, or whatever else your network finds",
            questions=(_model("it"), other, height),
            group=BY_NETWORK,
            rank=22,
        ),
    )
