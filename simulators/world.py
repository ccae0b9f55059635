"""One physical truth of the cell: things, places, suction, conveyor, imperfections, faults, verdict.

Every fact is held once, here. Protocol simulators read sensors and drive actuators; they hold protocol state only.
Nothing here runs by itself: what has happened since the last question is worked out when somebody asks
(`_settle`), from world time, so the world is exact at any clock speed.
"""

import math
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from simulators.arm import Arm
from simulators.clock import Clock
from simulators.conveyor import FAULTS as CONVEYOR_FAULTS
from simulators.conveyor import Conveyor
from simulators.golden import CARRIER as GOLDEN_CARRIER
from simulators.golden import GoldenParts
from simulators.layout import Carrier, build_layout
from simulators.place import Place
from simulators.product import Product
from simulators.suction import Suction
from simulators.supply import Delivery, Displacement, Scatter, Supply
from simulators.things import PLATE_MIDDLE, Base, Battery, Plate, made_base, made_battery
from simulators.verdict import Fit, Verdict, fit
from simulators.wear import FAULTS, Wear

TOUCH_MM = 0.6  # the cup's lip gives so much
FLOOR = "floor"


class World:
    """The cell as it truly is."""

    def __init__(self, seed: int, product: Product, *, speed: float = 1.0, carrier: Carrier = "tool") -> None:
        self.seed = seed
        self.product = product
        self.clock = Clock(speed)
        self.layout = build_layout(self.stream("layout"), carrier)
        self.arm = Arm(self.clock, self.stream("arm"))
        self.scatter = Scatter()
        self.supply = Supply(self.stream("supply"), self.scatter)
        self.conveyor = Conveyor(self.clock.now, self.stream("conveyor"))
        self.suction = Suction(self.clock.now)
        self.estop_pressed = self.guard_open = False
        self.air_ok = True
        self._valves: dict[str, bool] = {}
        self._robot_enable = False
        self.lights = {1: False, 2: False}
        self.lamp_levels = (False, False, False, False)
        self.base: Base | None = None
        self.on_table: Battery | None = None
        self.held: Battery | Plate | None = None
        self.seated: Battery | None = None
        self.plate = Plate("nest", Place(0.0, 0.0))
        self.lost: list[Battery | Plate] = []
        self.rejected: list[Battery | Plate] = []
        self.verdicts: list[Verdict] = []
        self.wear = {1: Wear(), 2: Wear()}
        self._carriers = 0
        self.golden = GoldenParts(self.scatter, self.stream)
        self._good = True
        self._cycle_since_s = 0.0
        self._no_seal = False
        self._subscribers: list[Callable[[], None]] = []
        self._handlers: dict[str, Callable[..., None]] = {}

    def stream(self, name: str) -> np.random.Generator:
        """Random numbers that depend on the seed and the name only."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    # -- safety ------------------------------------------------------------------------------------------

    def subscribe(self, callback: Callable[[], None]) -> None:
        """Call back, on the loop, whenever a safety fact changes."""
        self._subscribers.append(callback)

    def set_safety(
        self, *, estop: bool | None = None, guard_open: bool | None = None, air_ok: bool | None = None
    ) -> None:
        """A person presses or opens something."""
        self.estop_pressed = self.estop_pressed if estop is None else estop
        self.guard_open = self.guard_open if guard_open is None else guard_open
        self.air_ok = self.air_ok if air_ok is None else air_ok
        self._tell()

    @property
    def robot_enable(self) -> bool:
        """The PLC's output that lets the robot move."""
        return self._robot_enable

    @robot_enable.setter
    def robot_enable(self, on: bool) -> None:
        if on != self._robot_enable:
            self._robot_enable = on
            self._tell()

    def _tell(self) -> None:
        for callback in self._subscribers:
            callback()

    # -- sensors -----------------------------------------------------------------------------------------

    def photo_switch(self) -> bool:
        """Light beam at the station is broken."""
        self._settle()
        return self.conveyor.photo_switch()

    def carrier_clamped(self) -> bool:
        """The clamp holds a carrier."""
        self._settle()
        return self.conveyor.clamped and self.conveyor.occupied

    def battery_on_table(self) -> bool:
        """The table's presence sensor."""
        self._settle()
        return self.on_table is not None

    def conveyor_moving(self) -> bool:
        """The belt turns."""
        return self.conveyor.moving

    def vacuum_kpa(self) -> float:
        """Pressure at the cup against the room, negative when sucking."""
        self._settle()
        return self.suction.pressure_kpa()

    def carrier_id(self) -> int:
        """Number of the carrier at the station, 0 = none."""
        self._settle()
        return self.base.carrier_id if self.base and self.conveyor.occupied else 0

    # -- actuators ---------------------------------------------------------------------------------------

    def drive_conveyor(self, on: bool) -> None:
        """Belt motor."""
        self._settle()
        if on and not self.conveyor.moving and not self.conveyor.occupied:
            self._cycle_since_s = self.clock.now()
        self.conveyor.drive(on)

    def clamp(self, on: bool) -> None:
        """Carrier clamp."""
        self._settle()
        self.conveyor.clamp(on)

    def release_carrier(self, good: bool) -> None:
        """Lower the stop pin, with the diverter set."""
        self._settle()
        if self.conveyor.occupied and not self.conveyor.leaving:
            self._good = good
            self.conveyor.release()

    def valve(self, on: bool, by: str = "plc") -> None:
        """Vacuum valve. The robot's own, if it drives one, is piped beside the PLC's: either of them sucks."""
        self._settle()
        self._valves[by] = on
        self.suction.set(valve=any(self._valves.values()), sealed=self.held is not None)
        self._settle()

    def blow(self, on: bool) -> None:
        """Blow-off valve."""
        self._settle()
        self.suction.set(blow=on)

    def light(self, camera: int, on: bool) -> None:
        """Ring light of a camera."""
        self.lights[camera] = on

    def lamps(self, red: bool, amber: bool, green: bool, buzzer: bool) -> None:
        """Signal tower."""
        self.lamp_levels = (red, amber, green, buzzer)

    # -- faults ------------------------------------------------------------------------------------------

    def register(self, component: str, handler: Callable[..., None]) -> None:
        """A protocol simulator takes the faults of its component."""
        self._handlers[component] = handler

    def inject(self, component: str, fault: str, **params: object) -> None:
        """Make something go wrong. Raises ValueError for what cannot be done."""
        own: dict[tuple[str, str], Callable[[], None]] = {
            ("vacuum", "lost"): self.drop,
            ("vacuum", "no_seal"): lambda: self._set_no_seal(bool(params.get("on", True))),
            ("safety", "estop"): lambda: self.set_safety(estop=bool(params.get("on", True))),
            ("safety", "guard"): lambda: self.set_safety(guard_open=bool(params.get("on", True))),
            ("safety", "air"): lambda: self.set_safety(air_ok=not params.get("on", True)),
            ("supply", "no_base"): lambda: self.queue_deliveries([self._without_base()]),
        }
        for trouble in CONVEYOR_FAULTS:
            own["conveyor", trouble] = partial(self.conveyor.inject, trouble, bool(params.get("on", True)))
        for number, wear in self.wear.items():
            for name in FAULTS:
                own[f"camera_{number}", name] = partial(wear.inject, name, self.clock.now(), **params)
        if act := own.get((component, fault)):
            act()
        elif handler := self._handlers.get(component):
            handler(fault, **params)
        else:
            known = sorted({f"{c} {f}" for c, f in own} | {f"{c} ..." for c in self._handlers})
            raise ValueError(f"cannot inject {component} {fault}; there are: {', '.join(known)}")

    def drop(self) -> None:
        """What the cup holds falls off."""
        self._settle()
        if self.held is not None:
            self._let_go(FLOOR)
            self.suction.set(sealed=False)

    def queue_deliveries(self, deliveries: list[Delivery]) -> None:
        """Say what the line supplies next."""
        self.supply.queue.extend(deliveries)

    def _set_no_seal(self, on: bool) -> None:
        self._no_seal = on

    def _without_base(self) -> Delivery:
        drawn = self.supply.next()
        return Delivery(drawn.base, drawn.battery, drawn.sizes, has_base=False)

    # -- the person at the cell --------------------------------------------------------------------------

    def seat_golden_assembly(self) -> None:
        """A person puts a base to the drawing on the carrier and seats a battery to the drawing in its middle."""
        self._settle()
        self._take(self.held)
        self.base = made_base(self.product, self.layout.station, self.golden.delivery(), GOLDEN_CARRIER)
        self.seated = self._golden_battery("seat", self.golden.seat())
        self.on_table = None
        self.conveyor.put()

    def put_in_golden_pair(self) -> None:
        """A person takes the golden parts out and has the next pair at hand: good ones, a little different."""
        self._settle()
        self._take(self.held)
        self.base = self.seated = self.on_table = None
        self.golden.next_pair()

    def lay_reference_battery(self) -> None:
        """A person lays a battery to the drawing exactly where it should lie on the table."""
        self._settle()
        self._take(self.held)
        self.on_table = self._golden_battery("table", self.layout.table)

    def clear_station(self) -> None:
        """A person takes away base, batteries and whatever lies about, and puts the plate back into its nest."""
        self._settle()
        self._take(self.held)
        self.base = self.on_table = self.seated = None
        self.plate = Plate("nest", Place(0.0, 0.0))
        self.lost.clear()
        self.conveyor.remove()

    def _golden_battery(self, where: str, place: Place) -> Battery:
        return replace(made_battery(self.product, place, self.golden.delivery()), where=where)

    def _take(self, thing: Battery | Plate | None) -> None:
        if thing is not None:
            self.held = None
            self.suction.set(sealed=False)

    # -- truth -------------------------------------------------------------------------------------------

    def tool(self, at_s: float | None = None) -> Place:
        """The true tool frame in robot coordinates."""
        pose = self.arm.tool_at(self.clock.now() if at_s is None else at_s)
        return Place(pose.x_mm, pose.y_mm, pose.r_deg)

    def camera_1_carrier(self, at_s: float) -> Place:
        """The true frame of what camera 1 is on: the tool, or the second arm with its origin on the tool's axis."""
        tool = self.tool(at_s)
        return tool if self.layout.carrier == "tool" else tool._replace(t_deg=self.arm.second_arm_deg(at_s))

    def fit(self) -> Fit | None:
        """How the battery lies in the seat now, None when there is none."""
        self._settle()
        return self._fit()

    # -- what happens ------------------------------------------------------------------------------------

    def _settle(self) -> None:
        while event := self.conveyor.step():
            if event == "arrived":
                self._arrive()
            else:
                self._leave()
        self._attach_or_let_go()

    def _arrive(self) -> None:
        self._carriers += 1
        delivery = self.supply.next()
        self.base = made_base(self.product, self.layout.station, delivery, self._carriers)
        self.seated = None
        if self.on_table is None:
            self.on_table = made_battery(self.product, self.layout.table, delivery)

    def _leave(self) -> None:
        if self.base is not None:
            self.verdicts.append(
                Verdict(
                    number=len(self.verdicts) + 1,
                    carrier_id=self.base.carrier_id,
                    base=self.base.delivery.base,
                    battery=self.seated.displacement if self.seated else Displacement(),
                    fit=self._fit(),
                    released_good=self._good,
                    cycle_s=self.clock.now() - self._cycle_since_s,
                )
            )
        self.base = self.seated = None
        self._cycle_since_s = self.clock.now()

    def _fit(self) -> Fit | None:
        if self.base is None or self.seated is None:
            return None
        return fit(self.base.seat, self.seated.size, self.seated.place)

    def _attach_or_let_go(self) -> None:
        now_s = self.clock.now()
        if self.held is not None:
            falls_s = self.suction.lets_go_s()
            if falls_s is not None and falls_s <= now_s:
                self._let_go(self._below(falls_s), falls_s)
                self.suction.set(sealed=False)
        elif self.suction.valve and not self._no_seal and not self.arm.moving_at(now_s):
            self._attach(now_s)

    def _attach(self, now_s: float) -> None:
        tool = self.tool(now_s)
        z_mm = self.arm.tool_at(now_s).z_mm
        heights = self.layout.heights
        if self.on_table and self._touches(z_mm, heights.table_mm, self.on_table.place, tool):
            thing, self.on_table = self.on_table, None
            self._hold(thing, tool.back() @ thing.place)
        elif (
            self.base
            and self.seated
            and self._touches(z_mm, heights.seat_mm, self._seat_in_room() @ self.seated.place, tool)
        ):
            thing, self.seated = self.seated, None
            self._hold(thing, tool.back() @ self._seat_in_room() @ thing.place)
        elif self.plate.where == "nest" and self._touches(
            z_mm, heights.nest_mm, self._plate_in_room() @ PLATE_MIDDLE, tool
        ):
            self._hold(self.plate, tool.back() @ self._plate_in_room())

    def _hold(self, thing: Battery | Plate, in_tool: Place) -> None:
        thing.where, thing.place = "tool", in_tool
        self.held = thing
        self.suction.set(sealed=True)

    def _touches(self, z_mm: float, top_mm: float, place: Place, tool: Place) -> bool:
        return (
            abs(z_mm - top_mm) <= TOUCH_MM
            and math.hypot(tool.x_mm - place.x_mm, tool.y_mm - place.y_mm) <= self.product.grip_mm
        )

    def _let_go(self, where: str, at_s: float | None = None) -> None:
        thing = self.held
        assert thing is not None
        self.held = None
        in_room = self.tool(at_s) @ thing.place
        thing.where, thing.place = where, in_room
        if isinstance(thing, Plate) and where == "nest":
            thing.place = self.layout.nest.back() @ in_room
        elif isinstance(thing, Battery) and where == "seat" and self.base:
            thing.place = self._seat_in_room().back() @ in_room
            self.seated = thing
        elif isinstance(thing, Battery) and where == "table":
            self.on_table = thing
        else:
            (self.rejected if where == "reject" else self.lost).append(thing)

    def _below(self, at_s: float) -> str:
        """What a held part comes to lie on when it is let go at that time."""
        pose, heights, layout = self.arm.tool_at(at_s), self.layout.heights, self.layout
        here = [
            ("seat", heights.seat_mm, self._seat_in_room(), self.base is not None and self.seated is None),
            ("table", heights.table_mm, layout.table, self.on_table is None),
            ("nest", heights.nest_mm, layout.nest @ PLATE_MIDDLE, True),
            ("reject", heights.reject_mm, layout.reject, True),
        ]
        for name, z_mm, place, free in here:
            near = math.hypot(pose.x_mm - place.x_mm, pose.y_mm - place.y_mm) <= 5.0
            if free and near and abs(pose.z_mm - z_mm) <= TOUCH_MM:
                return name
        return FLOOR

    def _seat_in_room(self) -> Place:
        base = self.base.place if self.base else self.layout.station
        return base @ self.product.seat

    def _plate_in_room(self) -> Place:
        return self.layout.nest @ self.plate.place
