"""The pure part: what is known, what is decided, and nothing that touches the world.

No module here reads a clock, a file, a socket or a random number. A journal of observations replayed through
`stadimeter.core.decide.decide` gives the same decisions to the last bit.

Frames of reference: the camera frame has x to the right, y down and z along the optical axis. Bearings are positive to
the right, elevations positive upwards. A base turns positive to the left (counter-clockwise), as in ROS REP 103.
"""
