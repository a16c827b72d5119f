"""The workbench as a process: answers the page, so that the page itself needs no OpenCV and no camera."""
