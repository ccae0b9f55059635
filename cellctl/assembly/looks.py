"""What one look at a part is worth: the errors of its picture and of the part's form, in mm and rad of the part. Pure.

An edge errs by an offset to the left of its way and by a turn, both at the middle of its used stretch. The picture
says how well it shows the edge; how far the edge is from straight it shows only in part, so the recipe says that too.
"""

import math
from dataclasses import dataclass

import numpy as np

from cellctl.assembly.views import CORNER_SIGNS, corner_mm, direction_edge
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose
from cellctl.placement import Errors, Floats, beside, straight_fit
from cellctl.recipe_parts import Base, Battery
from cellctl.vision import BaseMeasurement, BatteryMeasurement
from cellctl.vision.features import Circle, Edge
from cellctl.vision.strip import BLOCK_PX

GRAIN_MM = 0.0003  # below this, form error and the grain of a surface look alike
BELIEVED = 3.0  # a picture is believed when it shows so many times the stated form error


@dataclass(frozen=True)
class Outline:
    """How a camera sees the outlines of its part, and how straight these are. Names are those of the sources."""

    camera: str
    plane: PlaneMap
    form: str
    form_mm: float  # 1 sigma
    form_length_mm: float  # its correlation length

    def edge(self, edge: Edge | None, length_mm: float) -> Errors:
        """2 rows: offset mm, turn rad. Without an edge: those of a perfect picture."""
        picture = np.zeros((2, 2)) if edge is None else self._shown(edge)
        wavy = straight_fit(length_mm, self._form_mm(edge, length_mm), self.form_length_mm)
        beyond = np.maximum(np.diag(wavy) - np.diag(picture), 0.0)  # a wavy edge is partly seen as such
        return Errors.of(self.camera, picture).and_of(Errors.of(self.form, np.diag(beyond)))

    def hole(self, circle: Circle | None, turn_deg: float) -> Errors:
        """2 rows: x, y mm of a frame that is turned like this in the plane."""
        if circle is None:
            return Errors.none(2)
        u, v = circle.centre
        corner, right, below = self.plane.mm_from_px([(u, v), (u + 1.0, v), (u, v + 1.0)])
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        to_frame = np.array([[c, s], [-s, c]]) @ np.stack([right - corner, below - corner], axis=1)
        return Errors.of(self.camera, circle.covariance_px2).mapped(to_frame)

    def _shown(self, edge: Edge) -> Floats:
        """The covariance of an edge in mm and rad. In a mirrored picture both change their sign."""
        units = np.array([self.plane.mm_per_px, math.radians(1.0)])
        return np.array(edge.covariance) * np.outer(units, units)

    def _form_mm(self, edge: Edge | None, length_mm: float) -> float:
        """The stated form error, or the one that the picture shows when that is clearly larger."""
        if edge is None:
            return self.form_mm
        shown_mm = self._shown_form_mm(edge, length_mm)
        return shown_mm if shown_mm > BELIEVED * max(self.form_mm, GRAIN_MM) else self.form_mm

    def _shown_form_mm(self, edge: Edge, length_mm: float) -> float:
        """Sigma of the form error by what the fitted line leaves of it, the noise of the pixels taken off.

        The noise of a block of pixels is the Cramer-Rao bound of an edge's place in it.
        """
        look = edge.appearance
        noise_px2 = 2 * math.sqrt(math.pi) * look.blur_px * (look.noise / look.contrast) ** 2 / BLOCK_PX
        offset, slope = np.diag(straight_fit(length_mm, 1.0, self.form_length_mm)).tolist()
        left = 1.0 - offset - slope * length_mm**2 / 12.0  # part of the form's variance that the line does not take up
        shown_px2 = max(0.0, edge.residual_px**2 - noise_px2)
        return math.sqrt(shown_px2 / left) * self.plane.mm_per_px


def base_look(outline: Outline, base: Base, seen: BaseMeasurement | None, turn_deg: float) -> Errors:
    """4 rows: x, y, turn of the base's frame, and the height of its reference edge's line over x = 0."""
    length_mm, middle_mm = base.edge_to_mm - base.edge_from_mm, (base.edge_to_mm + base.edge_from_mm) / 2
    hole = outline.hole(seen.circle if seen else None, turn_deg)
    edge = outline.edge(seen.edge if seen else None, length_mm)
    rows = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, -middle_mm]])
    return beside(hole, edge).mapped(rows)


def corner_look(outline: Outline, battery: Battery, seen: BatteryMeasurement | None) -> Errors:
    """3 rows: x, y, turn of the battery's frame (its middle, if it is of the drawn size)."""
    sx, sy = CORNER_SIGNS[battery.corner]
    first = outline.edge(seen.edge_1 if seen else None, battery.edge_x_mm)
    second = outline.edge(seen.edge_2 if seen else None, battery.edge_y_mm)
    # The edges run inwards from the corner, along -sx x and -sy y; left of their ways are -sx y and +sy x.
    far_1, far_2 = (battery.edge_skip_mm + length / 2 for length in (battery.edge_x_mm, battery.edge_y_mm))
    along_x = direction_edge(battery, seen) is seen.edge_1 if seen else battery.edge_x_mm >= battery.edge_y_mm
    turn = [0.0, 1.0, 0.0, 0.0] if along_x else [0.0, 0.0, 0.0, 1.0]
    corner = [[0.0, 0.0, sy, -sy * far_2], [-sx, sx * far_1, 0.0, 0.0], turn]
    return beside(first, second).mapped(corner).seen_from(Pose(*corner_mm(battery), 0.0))
