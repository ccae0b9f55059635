"""How a controller must be set up before the arm moves, read back setting by setting."""

import contextlib

from drivers import rcx
from drivers.controller import Controller
from drivers.errors import Mismatch, Refused
from drivers.rcx import Position
from drivers.reach import Limits

AUTOMATIC_SPEED_PCT = 100  # each move says its own share of it
SAME_PLACE_MM = 0.5  # between the axes' pulses and the position in millimetres


class Setup:
    """Done once after each opening and each power on, since a person may have changed something meanwhile.

    `payload_kg` is what the controller is told that the arm carries; None leaves that to its parameters.
    """

    def __init__(self, controller: Controller, limits: Limits, payload_kg: float | None) -> None:
        self.done = False
        self._controller = controller
        self._limits = limits
        self._payload_kg = payload_kg

    async def do(self) -> None:
        """Robot coordinates of the bare flange, full automatic speed, payload. Only possible with the control right.

        Raises Mismatch when something reads back otherwise; Refused, NoAnswer, LinkLost, Garbled.
        """
        if self.done:
            return
        for what, setting in (("HAND", "CHANGE OFF"), ("SHIFT", "SHIFT OFF")):
            await self._controller.set(setting)
            await self._check_off(what)
        speed_query = self._controller.dialect.speed_query
        await self._set(f"ASPEED {AUTOMATIC_SPEED_PCT}", speed_query, AUTOMATIC_SPEED_PCT)
        if self._payload_kg is not None:
            await self._set(*self._controller.dialect.payload(self._payload_kg))
        self.done = True

    async def check_place(self, position: Position) -> None:
        """Pulses and millimetres must tell the same place: else a tool, a work frame or other arms are set."""
        if self._limits.pulses is None:
            return
        by_axes = self._limits.from_pulses(await self._controller.pulses()).point
        if max(abs(a - b) for a, b in zip(position.point[:3], by_axes[:3], strict=True)) > SAME_PLACE_MM:
            detail = f"its axes stand at {by_axes}, but it says that it is at {position.point}"
            raise Mismatch(self._controller.device, detail)

    async def _check_off(self, what: str) -> None:
        with contextlib.suppress(Refused):  # firmware that does not know the question
            chosen = await self._controller.value(what, str)
            if chosen.upper() != "OFF":
                detail = f"{what} is {chosen}: choose none on the pendant, since positions are the flange's"
                raise Mismatch(self._controller.device, detail)

    async def _set(self, setting: str, what: str, wanted: int) -> None:
        await self._controller.set(setting)
        found = await self._controller.value(what, rcx.parse_leading_integer)
        if found != wanted:
            detail = f"{setting} was accepted, but {what} is {found}, not {wanted}"
            raise Mismatch(self._controller.device, detail)
