"""What the set-up asks about a picture of known size."""

from __future__ import annotations

from stadimeter.detectors.setup_kinds import SetupKind, SetupQuestion, size_question


def picture_kinds() -> tuple[SetupKind, ...]:
    """Return the picture."""
    text = "Which file shows the picture, from the front and with nothing around it?"
    form = "a scan or what was printed, such as poster.jpg"
    file = SetupQuestion("picture", text, lambda path: {"file": path}, "", form, files="*.[jp][pn]g")
    form = "its width, such as 42 cm; the height follows from the file"
    size = size_question("picture", lambda width: {"width": width}, "21 cm", form)
    meaning = "a poster, a book cover or another picture, of which you have a file"
    return (SetupKind("picture", meaning, (file, size), rank=5),)
