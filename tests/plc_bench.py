"""The delivered PLC program on a bench: wired to a true conveyor and cup, scanned by hand every 10 ms, no network."""

import random
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from simulators.conveyor import Conveyor
from simulators.plc_program import PlcProgram
from simulators.suction import Suction

SCAN_S = 0.01
BRING, RELEASE_GOOD, RELEASE_REJECT, STOP, RESET = range(1, 6)
OK, WRONG_STATE, UNKNOWN, TIMED_OUT, FAULT, NOT_YOUR_SESSION = range(6)
STARTING, READY, RUNNING, SILENT, IN_FAULT, EMERGENCY = range(6)


class Station:
    """The world: what the PLC is wired to, and a record of what truly happened."""

    def __init__(self, seed: int = 1) -> None:
        self.now_s = 0.0
        self.conveyor = Conveyor(lambda: self.now_s, np.random.default_rng(seed))
        self.suction = Suction(lambda: self.now_s)
        self.estop_pressed = self.guard_open = False
        self.air_ok = True
        self.robot_enable = False
        self.battery = False
        self.carrier = 0
        self.came = 0
        self.left: list[tuple[int, bool]] = []
        self.belt_starts = 0
        self.lights = {1: False, 2: False}
        self.tower = (False, False, False, False)
        self.seen_by_switch: bool | None = None  # instead of what is there
        self.pressure_kpa: float | None = None  # instead of what is there
        self._good = False

    def settle(self) -> None:
        while event := self.conveyor.step():
            if event == "arrived":
                self.came += 1
                self.carrier = 500 + self.came
            else:
                self.left.append((self.carrier, self._good))
                self.carrier = 0

    def photo_switch(self) -> bool:
        return self.conveyor.photo_switch() if self.seen_by_switch is None else self.seen_by_switch

    def carrier_clamped(self) -> bool:
        return self.conveyor.clamped and self.conveyor.occupied

    def battery_on_table(self) -> bool:
        return self.battery

    def conveyor_moving(self) -> bool:
        return self.conveyor.moving

    def vacuum_kpa(self) -> float:
        return self.suction.pressure_kpa() if self.pressure_kpa is None else self.pressure_kpa

    def carrier_id(self) -> int:
        return self.carrier

    def drive_conveyor(self, on: bool) -> None:
        self.belt_starts += on
        self.conveyor.drive(on)

    def clamp(self, on: bool) -> None:
        self.conveyor.clamp(on)

    def release_carrier(self, good: bool) -> None:
        self._good = good
        self.conveyor.release()

    def valve(self, on: bool) -> None:
        self.suction.set(valve=on, sealed=on)

    def blow(self, on: bool) -> None:
        self.suction.set(blow=on)

    def light(self, camera: int, on: bool) -> None:
        self.lights[camera] = on

    def lamps(self, *levels: bool) -> None:
        self.tower = levels  # type: ignore[assignment]


class Bench:
    """Station, PLC and the registers between the PLC and whoever writes to them."""

    def __init__(self, seed: int = 1, **settings: Any) -> None:
        self.station = Station(seed)
        self.registers = dict.fromkeys([*range(16), *range(100, 132)], 0)
        self.buttons: set[str] = set()
        self.program = PlcProgram(
            self.station,
            self.registers,
            photo_switch=self.station.photo_switch,
            button=lambda name: name in self.buttons,
            **settings,
        )
        self.frame: dict[int, int] = {0: 0, 1: 77, 3: 0, 4: 0, 5: 0, 6: 0}

    def __getitem__(self, register: int) -> int:
        return self.registers[register]

    def scan(self, scans: int = 1) -> None:
        """So many PLC cycles, with nothing new from the client."""
        for _ in range(scans):
            self.station.now_s += SCAN_S
            self.station.settle()
            self.program.scan(self.station.now_s, self.station.now_s)

    def beat(self, scans: int = 1, **words: int) -> None:
        """So many exchanges of a live client; words as w3=7 for register 3."""
        self.frame |= {int(name[1:]): value for name, value in words.items()}
        for _ in range(scans):
            self.frame[0] = (self.frame[0] + 1) & 0xFFFF
            self.registers.update(self.frame)
            self.scan()

    def command(self, command: int, argument: int = 0, *, within_s: float = 12.0) -> int:
        """Give a new command and return its result."""
        number = (self.registers[107] + 1) & 0xFFFF
        self.beat(w3=number, w4=command, w5=argument)
        for _ in range(round(within_s / SCAN_S)):
            if self.registers[107] == self.registers[108] == number:
                return self.registers[109]
            self.beat()
        raise AssertionError(f"command {command} is not finished: {[self.registers[at] for at in range(103, 115)]}")


def live(seed: int = 1, **settings: Any) -> Bench:
    """A bench whose client is served."""
    bench = Bench(seed, **settings)
    bench.scan(3)
    bench.beat(2)
    assert bench[102] == 77
    return bench


class Wire:
    """Between client and PLC packets get lost, come twice, or come late; and a book of what must have happened."""

    def __init__(self, bench: Bench, chance: random.Random) -> None:
        self.bench = bench
        self.came = 0
        self.left: list[tuple[int, bool]] = []
        self._chance = chance
        self._sent: deque[dict[int, int]] = deque(maxlen=500)

    def command(self, command: int, ways: Sequence[str]) -> None:
        """Give a command, disturbed in these ways before each packet, until the PLC says that it is finished."""
        bench, here = self.bench, self.bench.station.carrier
        number = (bench[107] + 1) & 0xFFFF
        bench.frame |= {3: number, 4: command, 5: here}
        while [bench[at] for at in (107, 108)] != [number, number]:
            for way in ways:
                self._disturb(way)
            bench.beat()
            self._sent.append(dict(bench.frame))
        self._book(command, here, bench[109])

    def _disturb(self, way: str) -> None:
        """One PLC cycle in which the wire does something."""
        if way == "lose":
            self.bench.frame[0] = (self.bench.frame[0] + 1) & 0xFFFF
        elif self._sent:
            self.bench.registers.update(self._sent[-1] if way == "repeat" else self._chance.choice(self._sent))
        self.bench.scan()

    def _book(self, command: int, here: int, result: int) -> None:
        """What this command must have done, once, and nothing else."""
        if command == BRING:
            assert result == (WRONG_STATE if here else OK)
            self.came += result == OK
        elif command in (RELEASE_GOOD, RELEASE_REJECT):
            assert result == (OK if here else WRONG_STATE)
            self.left += [(here, command == RELEASE_GOOD)] if here else []
        else:
            assert result == (OK if command in (STOP, RESET) else UNKNOWN)
        station = self.bench.station
        assert (self.bench[110], station.came, station.left) == (self.came & 0xFFFF, self.came, self.left)
        assert station.belt_starts == self.came + len(self.left)
