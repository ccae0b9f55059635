"""Finding base and battery in a picture: array in, measurement with its uncertainty or a named refusal out. Pure."""

from cellctl.vision.base import find_base
from cellctl.vision.battery import find_battery
from cellctl.vision.covariance import base_covariance, battery_covariance
from cellctl.vision.features import (
    Appearance,
    BaseMeasurement,
    BatteryMeasurement,
    Circle,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    NotFound,
    Search,
)
from cellctl.vision.single import find_circle, find_edge

__all__ = [
    "Appearance",
    "BaseMeasurement",
    "BatteryMeasurement",
    "Circle",
    "Edge",
    "ExpectedCircle",
    "ExpectedEdge",
    "Limits",
    "NotFound",
    "Search",
    "base_covariance",
    "battery_covariance",
    "find_base",
    "find_battery",
    "find_circle",
    "find_edge",
]
