"""The chosen hand (tool) and shift (work frame): between what a client says and what the flange does."""

import math

from simulators.robot.codes import Code, Refusal
from simulators.robot.tables import HIGHEST_HAND, HIGHEST_SHIFT, HandData, ShiftData, Tables
from simulators.scara import ToolPose

OFF = "OFF"
NO_HAND, NO_SHIFT = HandData(0.0, 0.0, 0.0, on_r=True), ShiftData(0.0, 0.0, 0.0, 0.0)


class Frames:
    """What CHANGE and SHIFT have chosen. An undefined one is all zeros."""

    def __init__(self, tables: Tables) -> None:
        self.hand = self.shift = OFF
        self._tables = tables

    def choose(self, what: str, name: str) -> None:
        """CHANGE H1, SHIFT S0, and OFF; raises Refusal."""
        letter, highest, code = {
            "CHANGE": ("H", HIGHEST_HAND, Code.HAND_NUMBER),
            "SHIFT": ("S", HIGHEST_SHIFT, Code.SHIFT_NUMBER),
        }[what]
        if name != OFF and not (name.startswith(letter) and name[1:].isdecimal()):
            raise Refusal(Code.SYNTAX)
        if name != OFF and int(name[1:]) > highest:
            raise Refusal(code)
        if what == "SHIFT":
            self.shift = name
        elif self._hand_data(name).on_r:
            self.hand = name
        else:
            raise Refusal(Code.HAND_TYPE)

    def flange(self, said: ToolPose) -> ToolPose:
        """Where the flange is when the tool is there in the work frame."""
        x, y, z, r = self._from_shift(said)
        dx, dy, dz = self._tool(r)
        return ToolPose(x - dx, y - dy, z - dz, r)

    def said(self, flange: ToolPose) -> ToolPose:
        """Where the tool is in the work frame when the flange is there."""
        dx, dy, dz = self._tool(flange.r_deg)
        return self._to_shift(ToolPose(flange.x_mm + dx, flange.y_mm + dy, flange.z_mm + dz, flange.r_deg))

    def in_use(self, kind: str, number: int) -> bool:
        """Whether this hand (H) or shift (S) is chosen."""
        return f"{kind}{number}" in (self.hand, self.shift)

    def _tool(self, r_deg: float) -> tuple[float, float, float]:
        hand = self._hand_data(self.hand)
        turn = math.radians(r_deg + hand.turn)
        return hand.length_mm * math.cos(turn), hand.length_mm * math.sin(turn), hand.height_mm

    def _from_shift(self, said: ToolPose) -> ToolPose:
        shift = self._shift_data()
        c, s = math.cos(math.radians(shift.dr_deg)), math.sin(math.radians(shift.dr_deg))
        x_mm = shift.dx_mm + c * said.x_mm - s * said.y_mm
        y_mm = shift.dy_mm + s * said.x_mm + c * said.y_mm
        return ToolPose(x_mm, y_mm, said.z_mm + shift.dz_mm, said.r_deg + shift.dr_deg)

    def _to_shift(self, tool: ToolPose) -> ToolPose:
        shift = self._shift_data()
        c, s = math.cos(math.radians(shift.dr_deg)), math.sin(math.radians(shift.dr_deg))
        x_mm, y_mm = tool.x_mm - shift.dx_mm, tool.y_mm - shift.dy_mm
        return ToolPose(c * x_mm + s * y_mm, c * y_mm - s * x_mm, tool.z_mm - shift.dz_mm, tool.r_deg - shift.dr_deg)

    def _hand_data(self, name: str) -> HandData:
        return NO_HAND if name == OFF else self._tables.hands.get(int(name[1:]), NO_HAND)

    def _shift_data(self) -> ShiftData:
        return NO_SHIFT if self.shift == OFF else self._tables.shifts.get(int(self.shift[1:]), NO_SHIFT)
