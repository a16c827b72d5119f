"""Turn a camera into a rangefinder that acts.

A stadimeter is the navigator's instrument that measures distance from an object's known height. This package does
the same with a camera: it finds an object of known size, measures how far away it is, says how sure it is, and lets
rules turn that into action.
"""

import os

__version__ = "0.1.0"

# OpenCV reads these once, when it is imported, which is never before this package. The first one holds for every
# picture that it decodes, from a file, a stream or a recording. What it would print, our errors say in one line.
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = "25000000"
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
