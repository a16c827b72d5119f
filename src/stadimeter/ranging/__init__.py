"""From a detection to a measurement: pure functions of points, sizes and a camera model."""
