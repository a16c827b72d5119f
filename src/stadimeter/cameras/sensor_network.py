"""A network on the sensor of a Raspberry Pi AI camera (IMX500): it finds boxes, which come with the frames."""

from __future__ import annotations

import numpy as np

from stadimeter.cameras.picamera2_settings import Metadata, Picamera2Settings
from stadimeter.core.frame import SensorBoxes
from stadimeter.errors import DeviceOpenError, LinkLostError

# The pixels of the whole sensor, which the network sees, and in which libcamera gives the crop.
SENSOR_PX = (4056.0, 3040.0)


class SensorNetwork:
    """A network on the sensor. Putting it there takes up to some minutes for the first time.

    Args:
        options: Of the camera; they name the network and the size of its pictures.

    Raises:
        DeviceOpenError: The package lacks what it takes, there is no such camera or file, or the picture is turned.
    """

    def __init__(self, options: Picamera2Settings) -> None:
        if options.upside_down:
            raise DeviceOpenError("a network on the sensor sees its picture unturned: leave out upside_down or network")
        try:
            from picamera2.devices import IMX500  # noqa: PLC0415 - only an AI camera needs it

            self._device = IMX500(str(options.network))
        except Exception as error:
            hint = "it is one of an AI camera's, *_pp.rpk from the package imx500-models"
            raise DeviceOpenError(f"the network {options.network} cannot be used: {error}; {hint}") from error
        self._size_px = np.array((options.width_px, options.height_px))

    def find(self, metadata: Metadata) -> SensorBoxes | None:
        """Return what it has found in a frame; None if it has not ended with one.

        Raises:
            LinkLostError: The network gives something else than boxes.
        """
        outputs = self._device.get_outputs(metadata)
        if outputs is None or "ScalerCrop" not in metadata:
            return None
        shapes = [each.shape for each in outputs]
        if len(outputs) < 3 or shapes[0] != (len(outputs[1]), 4) or len(shapes[1]) != 1 or shapes[2] != shapes[1]:
            raise LinkLostError(f"the network on the sensor gives {shapes}, no boxes, scores and classes; name another")
        corners, says = np.asarray(outputs[0], np.float64).reshape(-1, 2, 2), self._device.network_intrinsics
        if says is not None and says.bbox_normalization:
            corners = corners / self._device.get_input_size()[1]
        if says is None or says.bbox_order != "xy":
            corners = corners[:, :, ::-1]
        # The whole sensor is 0 to 1; the crop of it fills the picture, whose first pixel has its centre at 0.
        crop = np.array(metadata["ScalerCrop"], np.float64)
        corners_px = (corners * SENSOR_PX - crop[:2]) / crop[2:] * self._size_px - 0.5
        names = dict(enumerate((says.labels if says is not None else None) or ()))
        classes = tuple(names.get(number, str(number)) for number in outputs[2].astype(int).tolist())
        return SensorBoxes(corners_px.reshape(-1, 4), np.asarray(outputs[1], np.float64), classes)
