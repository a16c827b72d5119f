"""Pictures that show which of their pixels have a target's colour."""

from __future__ import annotations

import cv2
import numpy as np

from stadimeter.core.frame import Image
from stadimeter.detectors.protocol import ColourView
from stadimeter.workbench.annotation import Mark, annotate

BEHIND = 0.35
"""Brightness of what has another colour, beside how it was."""


def colour_picture(image: Image, view: ColourView, colour: str) -> Image:
    """Return a picture in which what has the colour stands out, the target is outlined, and other things are numbered.

    What has another colour is grey and dark.
    """
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown = np.where(view.mask[..., None] > 0, image, (BEHIND * grey).astype(np.uint8))
    words = f"{view.detection.width_px:.0f} px" if len(view.detection.outline_px) else "no ball is seen with it"
    mark = Mark(
        detection=view.detection,
        headline=words,
        lines=(f'hsv = "{colour}"', words),
        rejected=tuple(enumerate(view.others, start=1)),
    )
    return annotate(np.asarray(shown, np.uint8), [mark])
