"""The PLC of the cell: conveyor, vacuum, lights, signal tower, and whether the cell is safe.

The verbs here change words and wait for pictures; plc_scan moves both over the wire once per scan, plc_registers says
what they mean. Everything that happens is a counter or a latched bit, so nothing depends on when an exchange is made.
"""

import asyncio
from typing import Literal, NamedTuple

from drivers.errors import Garbled
from drivers.plc_buttons import Button
from drivers.plc_layout import Exchange, Layout, PlcAddress
from drivers.plc_picture import DEVICE
from drivers.plc_registers import CellWords, Command, Output, PlcImage, PlcState, why_unsafe
from drivers.plc_scan import PlcScan
from drivers.plc_tags import Seen

CARRY_WITHIN_S = 1.0


class Arrival(NamedTuple):
    """One base at the station, counted by the PLC."""

    sequence: int
    carrier_id: int
    age_s: float


class Plc:
    """Client of the PLC; `run` must run for anything else to work.

    Every verb outlasts a lost connection until its deadline. Then, or at once where that is sure, it raises LinkLost,
    NoAnswer, Garbled, Refused (the PLC said no: Modbus exception or command result) or Mismatch (another register map,
    another client is served). A command is executed exactly once or not at all, also when its caller is cancelled.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        unit_id: int = 1,
        scan_period_s: float = 0.01,
        stale_after_s: float = 0.25,
        exchange: Exchange = "fc23",
        layout: Layout | None = None,
    ) -> None:
        address = PlcAddress(host, port, unit_id, exchange, layout or Layout())
        self._scan = PlcScan(address, period_s=scan_period_s, stale_after_s=stale_after_s)
        self._turn = asyncio.Lock()  # one command after the other
        self._stop_turn = asyncio.Lock()  # stop overtakes the others, but not another stop

    async def run(self) -> None:
        """Connect, exchange once per scan, reconnect after 0.1 to 2 s; ends only by cancellation."""
        await self._scan.run()

    @property
    def scans(self) -> int:
        """Exchanges and attempts to connect so far: moves on as long as `run` is alive."""
        return self._scan.count

    @property
    def image(self) -> PlcImage:
        """The newest picture of registers 100..131.

        Raises what makes it worthless: LinkLost, NoAnswer (older than `stale_after_s`, or the PLC's heartbeat stood
        still for 500 ms), Mismatch (map version, foreign session), Garbled, Refused.
        """
        return self._scan.picture

    def seen(self) -> Seen:
        """All registers as they went over the wire last, with their ages, and the newest packets; at any time."""
        return self._scan.seen()

    async def ready(self, *, within_s: float) -> None:
        """Return when connected, with the right map version, the PLC program running and our session served."""
        async with self._scan.within(within_s, lambda: "PLC did not leave its starting state (register 103)"):
            await self._scan.until(lambda image: image.state is not PlcState.STARTING)

    # -- conveyor ------------------------------------------------------------------------------------------------

    async def bring_base(self, *, within_s: float) -> Arrival:
        """Let the next base come to the station. Each arrival is returned exactly once.

        A base that came for an earlier, cancelled call and still stands clamped is returned without a new command.
        """
        async with self._scan.within(within_s, lambda: "no base came; look at supply and conveyor:"), self._turn:
            image = await self._scan.idle()
            if not image.carrier_clamped:
                self._scan.taken = image.arrival_seq  # whatever came before has gone again
            if image.arrival_seq == self._scan.taken:
                await self._scan.command(Command.BRING_BASE)
        return self._take()

    async def base_at_station(self, *, within_s: float) -> None:
        """Wait until a base stands clamped at the station, whoever put it there."""
        async with self._scan.within(within_s, lambda: "no base is clamped at the station (register 105)"):
            await self._scan.until(lambda image: image.photo_switch and image.carrier_clamped)

    async def release(self, carrier_id: int, *, good: bool, within_s: float) -> None:
        """Let the carrier at the station go; returns when it has left. Refused when another carrier stands there."""
        command = Command.RELEASE_GOOD if good else Command.RELEASE_REJECT
        late = f"{command.words} of carrier {carrier_id} did not finish"
        async with self._scan.within(within_s, lambda: late), self._turn:
            await self._scan.command(command, carrier_id)

    async def stop_conveyor(self, *, within_s: float) -> None:
        """Stop the belt at once; a bring or release under way ends with Refused."""
        async with self._scan.within(within_s, lambda: "stop conveyor did not finish"), self._stop_turn:
            await self._scan.until(lambda image: True)
            self._scan.end_command("stop conveyor")
            await self._scan.command(Command.STOP_CONVEYOR)

    async def reset_latches(self, *, within_s: float) -> None:
        """Clear the latched safety bits (register 106) and the PLC's fault."""
        async with self._scan.within(within_s, lambda: "reset latches did not finish"), self._turn:
            await self._scan.command(Command.RESET_LATCHES)

    def _take(self) -> Arrival:
        """Take the newest arrival over. Nothing is awaited from here to the caller, so none can get lost."""
        image, before = self._scan.picture, self._scan.taken
        untaken = (image.arrival_seq - before) & 0xFFFF
        counter = "arrival counter (register 110)"
        if untaken == 0:
            raise Garbled(DEVICE, f"bring base is done but the {counter} is still {before}; check the switch")
        if untaken > 1:
            self._scan.taken = (image.arrival_seq - 1) & 0xFFFF
            went = f"{counter} went from {before} to {image.arrival_seq}"
            raise Garbled(DEVICE, f"{went}: {untaken - 1} passed unseen; look at the station, then bring again")
        self._scan.taken = image.arrival_seq
        return Arrival(image.arrival_seq, image.carrier_id, image.arrival_age_s + self._scan.picture_age_s)

    # -- outputs -------------------------------------------------------------------------------------------------

    async def vacuum(self, on: bool, *, within_s: float) -> None:
        """Switch the vacuum valve and wait until the vacuum switch agrees; the valve stays as asked in any case."""
        self._put(Output.VACUUM, on)
        async with self._scan.within(within_s, lambda: self._vacuum_text(on)):
            await self._scan.carry()
            await self._scan.until(lambda image: image.vacuum_reached == on)

    async def vacuum_seen(self, on: bool, *, within_s: float) -> None:
        """Wait until the vacuum switch agrees with a valve that is not the PLC's."""
        async with self._scan.within(within_s, lambda: self._vacuum_text(on)):
            await self._scan.until(lambda image: image.vacuum_reached == on)

    async def blow_off(self, on: bool) -> None:
        """Switch the blow-off valve; returns after the exchange that carried it."""
        await self._switch(Output.BLOW_OFF, on)

    async def light(self, camera: Literal[1, 2], on: bool) -> None:
        """Switch the light of a camera; returns after the exchange that carried it."""
        await self._switch(Output.LIGHT_1 if camera == 1 else Output.LIGHT_2, on)

    def show(
        self, *, machine_state: int, good: int, rejected: int, red: bool, amber: bool, green: bool, buzzer: bool
    ) -> None:
        """Machine state, counts and signal tower; goes out with the next exchange."""
        self._scan.shown = CellWords(machine_state=machine_state, good=good, rejected=rejected)
        lamps = ((Output.RED, red), (Output.AMBER, amber), (Output.GREEN, green), (Output.BUZZER, buzzer))
        for lamp, on in lamps:
            self._put(lamp, on)

    def _put(self, output: Output, on: bool) -> None:
        outputs = self._scan.outputs
        self._scan.outputs = outputs | output if on else outputs & ~output

    async def _switch(self, output: Output, on: bool) -> None:
        self._put(output, on)
        async with self._scan.within(CARRY_WITHIN_S, lambda: f"no exchange carried {output.name} (register 6)"):
            await self._scan.carry()

    def _vacuum_text(self, on: bool) -> str:
        wanted, kpa = ("on" if on else "off"), self._scan.picture.vacuum_kpa
        return f"vacuum switch (register 105 bit 1) did not go {wanted}, vacuum (register 115) is {kpa:.1f} kPa;"

    # -- buttons -------------------------------------------------------------------------------------------------

    async def pressed(self) -> Button:
        """The next press of a button at the PLC, however short; waits without a deadline.

        Each press is returned once. Those from before our session or from while the link was down never are; of
        several in one exchange stop comes first, then reset, then start.
        """
        return await self._scan.pressed()

    # -- safety --------------------------------------------------------------------------------------------------

    async def unsafe(self) -> str:
        """Return, with a sentence that says why, as soon as safety is or was lost, or cannot be seen any more."""
        boot = self._scan.boot
        reason = ""

        def seen() -> bool:
            nonlocal reason
            reason = reason or self._unsafe_since(boot)  # the first one, also when it has passed before we are woken
            return bool(reason)

        await self._scan.wait(seen)
        return reason

    def _unsafe_since(self, boot: int | None) -> str:
        trouble = self._scan.trouble()
        if trouble is not None:
            return trouble.detail
        if self._scan.boot != boot:
            return f"PLC restarted (boot counter in register 117 went from {boot} to {self._scan.boot})"
        return why_unsafe(self._scan.picture)
