"""The place of the camera itself, frame by frame: the tags of known places are looked for, and their corners tell."""

from __future__ import annotations

from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import CameraPose, Landmarks
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.detectors.protocol import FindsSeveral
from stadimeter.ranging.camera_pose import ExpectedPose, SeenLandmark, locate_camera

# A tag counts as moved once this many frames in a row say so: by chance one in 100,000 does.
MOVED_FRAMES = 5


class CameraLocator:
    """Finds the pose of one camera in one frame after the other."""

    def __init__(self, landmarks: Landmarks, detector: FindsSeveral, viewpoint: Viewpoint) -> None:
        self._landmarks = landmarks
        self._tags = {tag.number: tag for tag in landmarks.tags}
        self._detector = detector
        self._expected = ExpectedPose(viewpoint)
        self._moved: dict[int, int] = {}  # in how many frames in a row each tag was not where it should be

    def locate(self, frame: Frame, lens: CameraModel) -> CameraPose:
        """Return where the camera was when a frame was taken, or why that is not known.

        Args:
            lens: The camera model at the frame's resolution.
        """
        found = self._detector.detect_all(frame, lens=lens)
        seen = [
            SeenLandmark(self._tags[each.number], each)
            for each in found
            if each.status is DetectionStatus.FOUND and each.number in self._tags
        ]
        pose = locate_camera(seen, self._landmarks, lens, self._expected, frame.captured_at_s)
        self._moved = {number: self._moved.get(number, 0) + 1 for number in pose.moved}
        if pose.position_m is not None:
            self._expected = self._expected._replace(before=pose)
        return pose

    def trouble(self) -> str:
        """Return which tags are not where the configuration says, in words; empty for none."""
        moved = tuple([number for number, frames in self._moved.items() if frames >= MOVED_FRAMES])
        return replace(CameraPose(captured_at_s=0.0), moved=moved).moved_words
