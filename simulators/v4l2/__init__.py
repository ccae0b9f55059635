"""A simulated V4L2 camera: one state machine, reached through a FUSE file with real ioctls, or in the same process."""

from simulators.v4l2.camera import V4l2CameraServer
from simulators.v4l2.device import Device
from simulators.v4l2.fuse_mount import why_not
from simulators.v4l2.sensor import Timing

__all__ = ["Device", "Timing", "V4l2CameraServer", "why_not"]
