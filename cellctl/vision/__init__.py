"""Finding base and battery in a picture: array in, measurement with its uncertainty or a named refusal out. Pure."""

from cellctl.vision.base import find_base
from cellctl.vision.battery import find_battery
from cellctl.vision.features import (
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

__all__ = [
    "BaseMeasurement",
    "BatteryMeasurement",
    "Circle",
    "Edge",
    "ExpectedCircle",
    "ExpectedEdge",
    "Limits",
    "NotFound",
    "Search",
    "find_base",
    "find_battery",
]
