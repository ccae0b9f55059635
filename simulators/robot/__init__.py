"""An RCX340 controller on the world's arm: speaks its online commands over TCP and a serial line."""

from simulators.robot.controller import RobotController

__all__ = ["RobotController"]
