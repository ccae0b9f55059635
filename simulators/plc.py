"""The simulated PLC: a Modbus server, the program it executes, its wires to the world, and what can go wrong."""

import asyncio
import contextlib
import inspect
import sys
import time
from collections.abc import Callable, Iterator, MutableMapping
from typing import Protocol

from simulators.clock import Clock
from simulators.modbus import ModbusServer
from simulators.modbus_bank import Bank, Table
from simulators.modbus_identity import Identity
from simulators.plc_program import ORDERS, PICTURE, PlcProgram, Program
from simulators.plc_wiring import PlcWorld
from simulators.st.errors import StFault

CYCLE_S = 0.01  # PLC cycle in world seconds
SHORTEST_PAUSE_WALL_S = 0.002
LONGEST_STEP_S = 0.2  # world time waits for the next cycle, so a busy computer cannot make the PLC miss a carrier
FRESH_WALL_S = 0.001
BUTTONS = ("start", "stop", "reset")


class CellWorld(PlcWorld, Protocol):
    """The world with what a protocol simulator needs besides its wires."""

    @property
    def clock(self) -> Clock:
        """World time."""

    def subscribe(self, callback: Callable[[], None]) -> None:
        """Call back when a safety fact changes."""

    def register(self, component: str, handler: Callable[..., None]) -> None:
        """Take the faults of a component."""


class MakeProgram(Protocol):
    """How a program for the PLC is made; PlcProgram is one."""

    def __call__(
        self,
        world: PlcWorld,
        memory: MutableMapping[int, int],
        *,
        photo_switch: Callable[[], bool],
        button: Callable[[str], bool],
    ) -> Program:
        """Switch the PLC on."""


class PhotoSwitch:
    """The wire from the station's switch, with its faults. Times in world seconds."""

    def __init__(self, world: CellWorld) -> None:
        self._world = world
        self._pulse_until_s = 0.0
        self._bounce = (0, 0.0)  # edges, seconds; armed for the next carrier
        self._bounce_since_s: float | None = None
        self.stuck: bool | None = None

    def pulse(self, for_s: float) -> None:
        """On for a moment although nothing is there."""
        self._pulse_until_s = self._world.clock.now() + for_s

    def bounce(self, edges: int, for_s: float) -> None:
        """Chatter at the next carrier."""
        self._bounce, self._bounce_since_s = (edges, for_s), None

    def __call__(self) -> bool:
        """What the PLC's input sees now."""
        on, now_s = self._world.photo_switch(), self._world.clock.now()
        if self.stuck is not None:
            return self.stuck
        edges, for_s = self._bounce
        if edges and on and self._bounce_since_s is None:
            self._bounce_since_s = now_s
        if self._bounce_since_s is not None:
            share = (now_s - self._bounce_since_s) / for_s
            if share < 1:
                return on and int(share * edges) % 2 == 0
            self._bounce, self._bounce_since_s = (0, 0.0), None
        return on or now_s < self._pulse_until_s


class PlcServer:
    """The PLC of the cell on a real port; `port` is known after start()."""

    def __init__(
        self,
        world: CellWorld,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        unit_id: int = 1,
        program: MakeProgram = PlcProgram,
    ) -> None:
        self._world = world
        bank = Bank(holding=[*ORDERS, *PICTURE], read_only=PICTURE)
        bank.after_write = lambda table, address, count: self._scan()
        bank.before_read = lambda table, address, count: self._scan(FRESH_WALL_S)
        self.memory = bank.tables[Table.HOLDING]
        identity = Identity({0: b"cellctl", 1: b"simulated PLC", 2: b"1.0", 4: b"cell register map 0x0100"})
        self.modbus = ModbusServer(bank, host=host, port=port, unit_id=unit_id, identity=identity)
        self.photo_switch = PhotoSwitch(world)
        self._pressed: dict[str, float] = {}  # button -> wall time of its release
        self._overrides: dict[int, int] = {}
        self._foreign = 0
        self._stopped = False
        self._scanning = False
        self._scanned_wall_s = 0.0
        self._ticker: asyncio.Task[None] | None = None
        self.program = program(world, self.memory, photo_switch=self.photo_switch, button=self._button_down)
        self.fault: StFault | None = None  # why the program has stopped, if it has
        world.subscribe(self._scan)  # so that a short pulse of the emergency stop is latched
        world.register("plc", self.inject)

    @property
    def port(self) -> int:
        """TCP port."""
        return self.modbus.port

    async def start(self) -> None:
        """Power on."""
        await self.modbus.start()
        self._ticker = asyncio.create_task(self._tick(), name="simulated PLC")

    async def close(self) -> None:
        """Power off. May be called twice."""
        ticker, self._ticker = self._ticker, None
        if ticker is not None:
            ticker.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await ticker
            self.program.halt()
        await self.modbus.close()

    def press(self, button: str, for_s: float = 0.1) -> None:
        """A person presses "start", "stop" or "reset" for so many wall seconds."""
        if button not in BUTTONS:
            raise ValueError(f"no button {button!r}; there are: {', '.join(BUTTONS)}")
        self._pressed[button] = time.monotonic() + for_s

    def inject(self, fault: str, **params: object) -> None:
        """Make something go wrong; raises ValueError for an unknown fault or parameter."""
        faults: dict[str, Callable[..., None]] = {
            "map_version": self._fault_map_version,
            "program_stop": self._fault_program_stop,
            "heartbeat_freeze": self._fault_heartbeat_freeze,
            "reboot": self._fault_reboot,
            "foreign_session": self._fault_foreign_session,
            "exception": self._fault_exception,
            "mute": self._fault_mute,
            "delay": self._fault_delay,
            "drop_answer": self._fault_drop_answer,
            "cut_answer": self._fault_cut_answer,
            "short_pulse": self._fault_short_pulse,
            "bounce": self._fault_bounce,
            "photo_stuck": self._fault_photo_stuck,
            "press": self.press,
        }
        if fault not in faults:
            raise ValueError(f"cannot inject plc {fault}; there are: {', '.join(sorted(faults))}")
        try:
            inspect.signature(faults[fault]).bind(**params)
        except TypeError as error:
            raise ValueError(f"cannot inject plc {fault}: {error}") from None
        faults[fault](**params)

    # -- the cycle -----------------------------------------------------------------------------------------------

    async def _tick(self) -> None:
        """Cycle after cycle. World time waits for each; the next wait begins before the last one ends."""
        clock = self._world.clock
        with contextlib.ExitStack() as waits:
            waits.enter_context(clock.due_by(clock.now() + LONGEST_STEP_S))
            while True:
                await asyncio.sleep(max(CYCLE_S / clock.speed, SHORTEST_PAUSE_WALL_S))
                self._scan()
                before = waits.pop_all()
                waits.enter_context(clock.due_by(clock.now() + LONGEST_STEP_S))
                before.close()

    def _scan(self, unless_younger_s: float = 0.0) -> None:
        """One PLC cycle; not when the last one is younger than that, nor inside another one."""
        now_wall_s = time.monotonic()
        running = self._ticker is not None and not self._stopped and not self._scanning
        if not running or now_wall_s - self._scanned_wall_s < unless_younger_s:
            return
        self._scanning = True
        self._scanned_wall_s = now_wall_s
        try:
            with self._foreign_words():
                self.program.scan(self._world.clock.now(), now_wall_s)
        except StFault as fault:  # what a PLC does then: STOP until power comes anew
            self.fault = fault
            self._fault_program_stop()
            print(f"simulated PLC: {fault}; it is in STOP", file=sys.stderr)
        finally:
            self._scanning = False
        self.memory.update(self._overrides)

    @contextlib.contextmanager
    def _foreign_words(self) -> Iterator[None]:
        """While that fault lasts, another client overwrites what ours has written before the program sees it."""
        if not self._foreign:
            yield
            return
        ours = {at: self.memory[at] for at in ORDERS}
        self.memory.update(dict.fromkeys(ORDERS, 0))
        self.memory[0], self.memory[1] = int(time.monotonic() * 1000) & 0xFFFF, self._foreign
        yield
        self.memory.update(ours)

    def _button_down(self, name: str) -> bool:
        return time.monotonic() < self._pressed.get(name, 0.0)

    # -- faults --------------------------------------------------------------------------------------------------

    def _override(self, address: int, value: int | None) -> None:
        self._overrides.pop(address, None)
        if value is not None:
            self._overrides[address] = value

    def _fault_map_version(self, value: int = 0x0200, on: bool = True) -> None:
        """Another program with another register map was loaded."""
        self._override(101, value if on else None)

    def _fault_heartbeat_freeze(self, on: bool = True) -> None:
        """The heartbeat word stands still, everything else goes on."""
        self._override(100, self.memory[100] if on else None)

    def _fault_program_stop(self, on: bool = True) -> None:
        """The PLC is in STOP: it still answers, from standing memory."""
        self._stopped = on
        if on:
            self.program.halt()

    def _fault_reboot(self) -> None:
        """Power fails for a moment: connections break, memory is cleared, the boot counter moves on."""
        self.program.halt()
        self.memory.update(dict.fromkeys(self.memory, 0))
        self.program.restart()
        if self.fault is not None:
            self.fault, self._stopped = None, False
        self.modbus.break_connections()

    def _fault_foreign_session(self, session: int = 0xBEEF, on: bool = True) -> None:
        """Another client writes over ours; once ours counts as silent for 1 s the PLC serves the other."""
        self._foreign = session if on else 0

    def _fault_exception(self, code: int = 4, on: bool = True) -> None:
        """Every request gets this exception."""
        self.modbus.troubles.exception = code if on else None

    def _fault_mute(self, on: bool = True) -> None:
        """Requests are swallowed."""
        self.modbus.troubles.mute = on

    def _fault_delay(self, delay_s: float = 0.3, on: bool = True) -> None:
        """Answers come so many wall seconds late."""
        self.modbus.troubles.delay_s = delay_s if on else 0.0

    def _fault_drop_answer(self, count: int = 1) -> None:
        """So many requests are executed but not answered."""
        self.modbus.troubles.drop_answers = count

    def _fault_cut_answer(self, count: int = 1) -> None:
        """So many requests are executed, then the connection breaks instead of an answer."""
        self.modbus.troubles.cut_answers = count

    def _fault_short_pulse(self, pulse_ms: float = 5.0) -> None:
        """The photoelectric switch sees something that is not there."""
        self.photo_switch.pulse(pulse_ms / 1000)

    def _fault_bounce(self, edges: int = 3, bounce_ms: float = 15.0) -> None:
        """The photoelectric switch chatters at the next carrier."""
        self.photo_switch.bounce(edges, bounce_ms / 1000)

    def _fault_photo_stuck(self, value: bool | None = True) -> None:
        """The photoelectric switch stays on (True) or off (False); None heals it."""
        self.photo_switch.stuck = value
