"""The driver of the robot as cell.toml describes it."""

from cellctl.config import RobotConfig
from drivers.rcx import LEFTY, RIGHTY
from drivers.reach import Limits
from drivers.robot import Robot

HANDS = {"righty": RIGHTY, "lefty": LEFTY}


def build_robot(robot: RobotConfig) -> Robot:
    """The driver; nothing is connected yet."""
    return Robot(
        robot.address,
        limits=limits_of(robot),
        dialect=robot.dialect,
        hand=HANDS[robot.hand],
        payload_kg=robot.payload_kg,
        dynamics=robot.speeds.dynamics,
    )


def limits_of(robot: RobotConfig) -> Limits:
    """Where the arm may be sent."""
    return Limits(
        arm_1_mm=robot.arm_1_mm,
        arm_2_mm=robot.arm_2_mm,
        inner_reach_mm=robot.reach_inner_mm,
        outer_reach_mm=robot.reach_outer_mm,
        z_min_mm=robot.z_min_mm,
        z_max_mm=robot.z_max_mm,
        r_min_deg=robot.r_min_deg,
        r_max_deg=robot.r_max_deg,
        pulses=robot.pulses.limits if robot.pulses else None,
    )
