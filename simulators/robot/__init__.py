"""Yamaha controllers on the world's arm: an RCX340, or an RCX240, over TCP and over a serial line."""

from simulators.robot.bench import Bench
from simulators.robot.controller import RobotController
from simulators.robot.options import Options
from simulators.robot.ports import Wiring

__all__ = ["Bench", "Options", "RobotController", "Wiring"]
