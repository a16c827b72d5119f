"""Detectors: find a target in a frame. The interface is in `stadimeter.detectors.protocol`."""
