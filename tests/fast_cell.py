"""A cell without wires, time and threads: the simulators' true world and the controller's own functions, unit by unit.

The world: a cell bolted together by people, parts with sizes and form, an arm that misses every stop. The controller:
teaching, views, budget and place pose, unmodified; only the order of the cycle is written down here once more. Judged
by the world's true corners. How the cameras see is `tests.fast_eyes`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, Protocol

import numpy as np

from cellctl.assembly import views
from cellctl.assembly.budget import Budget, CornerAgain, EdgeAgain, Located
from cellctl.assembly.hand import commanded
from cellctl.assembly.stops import looking_at_base, looking_at_battery
from cellctl.config import CellConfig
from cellctl.geometry import Pose, mean_pose, place_pose
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.references import now
from cellctl.learnt.taught import Taught, TaughtCorner, TaughtEdge, geometry_of
from cellctl.placement import Prediction, WorstCorner
from cellctl.procedures.golden import Assemblies, Golden
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement, Edge
from simulators.layout import Layout
from simulators.place import Place
from simulators.product import Product
from simulators.supply import Delivery, Displacement, Form, Sizes
from simulators.things import Base, Battery, made_base, made_battery
from simulators.verdict import Fit, fit

Policy = Literal["never", "when_needed", "always"]
Calibrations = tuple[CameraCalibration, CameraCalibration]


class Eyes(Protocol):
    """How the two cameras see what is before them: a measurement, or NotFound."""

    def base(self, tool: Place, base: Base, tool_from_base: Pose) -> BaseMeasurement:
        """Camera 1 over a base; `tool` is where the tool truly stands, the pose is what is expected."""

    def edge(self, tool: Place, base: Base, tool_from_base: Pose) -> Edge:
        """Camera 1 over the second stretch of its edge."""

    def battery(
        self, tool: Place, battery: Battery, robot_from_battery: Pose, *, opposite: bool = False
    ) -> BatteryMeasurement:
        """Camera 2 under a battery; its place is that in the tool."""


@dataclass(frozen=True)
class Robot:
    """The arm as it truly is: one sigma per coordinate of every stop."""

    sd_mm: float = 0.01 / 3
    sd_deg: float = 0.004 / 3


@dataclass
class Looked:
    """A part by one look, and by two as soon as somebody asks for the second."""

    once: Located
    look_again: Callable[[], Located]

    @cached_property
    def twice(self) -> Located:
        """By both."""
        return self.look_again()

    def by(self, looks: int) -> Located:
        """By so many looks."""
        return self.once if looks == 1 else self.twice


class Placed(NamedTuple):
    """What was predicted of a placement, and what came of it (or would have, if it was a no-go)."""

    prediction: Prediction
    fit: Fit
    probability: float  # predicted, of an error up to the true one
    looks: tuple[int, int]


class FastCell:
    """One cell from its bolts on."""

    def __init__(
        self, seed: int, config: CellConfig, recipe: Recipe, product: Product, layout: Layout, robot: Robot = Robot()
    ) -> None:
        self.config, self.recipe, self.product, self.layout, self.robot = config, recipe, product, layout, robot
        self._rng = np.random.default_rng([seed, 1])
        self._eyes: Eyes
        self.budgets: dict[Policy, Budget] = {}

    # -- the world ---------------------------------------------------------------------------------------------

    def stop(self, pose: Pose) -> Place:
        """Where the tool truly comes to stand."""
        x, y, t = (float(error) for error in self._rng.standard_normal(3))
        at, robot = Pose(*(round(number, 3) for number in pose)), self.robot  # as an RCX340 is told it
        return Place(at.x_mm + x * robot.sd_mm, at.y_mm + y * robot.sd_mm, at.t_deg + t * robot.sd_deg)

    # -- teaching ----------------------------------------------------------------------------------------------

    def commission(self, eyes: Eyes, calibrations: Calibrations, form: Form, repeats: int, pairs: int = 1) -> None:
        """Teach with golden assemblies whose parts are to the drawing and as straight as `form` says."""
        self._eyes = eyes
        recipe = self.recipe
        axis_1 = views.axis_mm(calibrations[0].plane, self.config.camera_1)
        axis_2 = views.axis_mm(calibrations[1].plane, self.config.camera_2)
        self._planes = calibrations[0].plane, calibrations[1].plane
        self._look_1 = looking_at_base(self.config, recipe.base, axis_1)
        self._again_1 = looking_at_base(self.config, recipe.base.second_view, axis_1)
        self._look_2 = looking_at_battery(recipe.battery, axis_2)
        self._again_2 = looking_at_battery(recipe.battery.diagonal, axis_2)
        golden = Assemblies(
            tuple(
                self._golden(pair, replace(form, seed=form.seed + pair))
                for pair in range(1, pairs + 1)
                for _ in range(repeats)
            )
        )
        taught = self._taught(golden, calibrations, repeats)
        for policy in ("never", "when_needed", "always"):
            placement = recipe.placement.model_copy(update={"second_look": policy})
            self.budgets[policy] = Budget(
                self.config, recipe.model_copy(update={"placement": placement}), calibrations, taught
            )

    def _golden(self, pair: int, form: Form) -> Golden:
        perfect = Delivery(Displacement(), Displacement(), Sizes(), form=form)
        base = made_base(self.product, self.layout.station, perfect, 9000)
        battery = made_battery(self.product, self.layout.table, perfect)
        robot_from_base, seen = self._see_base(base, _pose(self.layout.station))
        found = self._second_edge(base, robot_from_base, seen)[1]
        seat = commanded(robot_from_base @ self.recipe.base.seat)
        held = replace(battery, place=self.stop(seat).back() @ base.place @ self.product.seat)
        tool_from_battery, _ = self._see_battery(held, Pose(0.0, 0.0, 0.0))
        other = self._opposite(held, tool_from_battery)[1]
        base_from_battery = robot_from_base.inverse() @ seat @ tool_from_battery
        corner = tool_from_battery.inverse() @ other
        return Golden(pair, robot_from_base, base_from_battery, tool_from_battery, found, corner)

    def _taught(self, golden: Assemblies, calibrations: Calibrations, repeats: int) -> Taught:
        spread, between = golden.repeat_spread, golden.pair_spread
        assert golden.second_edge is not None
        assert golden.second_corner is not None
        table = self.config.positions.table
        return Taught(
            made_at=now(),
            recipe="fast",
            geometry=geometry_of(self.recipe),
            calibrations=(calibrations[0].id, calibrations[1].id),
            look_1=self._look_1,
            look_2=self._look_2,
            robot_from_base=mean_pose(sample.robot_from_base for sample in golden.samples),
            base_from_battery=golden.mean,
            tool_from_battery=mean_pose(sample.tool_from_battery for sample in golden.samples),
            table_pick=Pose(table.x_mm, table.y_mm, table.t_deg),
            robot_from_battery_on_table=_pose(self.layout.table),
            repeats=repeats,
            pairs=len(golden.pairs),
            spread_mm=spread.xy_mm,
            spread_deg=spread.t_deg,
            between_mm=between.xy_mm if between else None,
            between_deg=between.t_deg if between else None,
            second_edge=TaughtEdge(stop=self._again_1, found=golden.second_edge),
            second_corner=TaughtCorner(stop=self._again_2, found=golden.second_corner),
        )

    # -- one unit ----------------------------------------------------------------------------------------------

    def assemble(self, delivery: Delivery, policies: Iterable[Policy]) -> dict[Policy, Placed]:
        """The same parts, looked at as each policy wants it. Raises NotFound."""
        base = made_base(self.product, self.layout.station, delivery, 1)
        battery = made_battery(self.product, self.layout.table, delivery)
        located = self._locate_base(base)
        held = replace(battery, place=self.stop(self.taught.table_pick).back() @ battery.place)
        in_tool = self._locate_battery(held)
        return {policy: self._placed(policy, base, held, located, in_tool) for policy in policies}

    @property
    def taught(self) -> Taught:
        """What the golden assemblies gave."""
        return self.budgets["never"].taught

    def _locate_base(self, base: Base) -> Looked:
        budget = self.budgets["never"]
        robot_from_base, seen = self._see_base(base, self.taught.robot_from_base)

        def again() -> Located:
            return budget.base(seen, robot_from_base, EdgeAgain(*self._second_edge(base, robot_from_base, seen)))

        return Looked(budget.base(seen, robot_from_base), again)

    def _locate_battery(self, held: Battery) -> Looked:
        budget = self.budgets["never"]
        tool_from_battery, seen = self._see_battery(held, self.taught.tool_from_battery)

        def again() -> Located:
            return budget.battery(seen, tool_from_battery, CornerAgain(*self._opposite(held, tool_from_battery)))

        return Looked(budget.battery(seen, tool_from_battery), again)

    def _placed(self, policy: Policy, base: Base, held: Battery, located: Looked, in_tool: Looked) -> Placed:
        """Go, look again or no-go, as cellctl.cycle does it; a no-go is judged as if it had been placed."""
        budget = self.budgets[policy]
        looks = [1 + budget.needs.base_again, 1 + budget.needs.battery_again]
        prediction = budget.placement(located.by(looks[0]), in_tool.by(looks[1]))
        if not prediction.good and budget.may_look_again and looks[1] == 1:
            looks[1] = 2
            prediction = budget.placement(located.by(looks[0]), in_tool.by(looks[1]))
        by_base, by_battery = located.by(looks[0]), in_tool.by(looks[1])
        at = place_pose(by_base.pose, self.taught.base_from_battery, by_battery.pose)
        in_seat = (base.place @ self.product.seat).back() @ self.stop(at) @ held.place
        lies = fit(base.seat, held.size, in_seat)
        worst = WorstCorner(budget.errors(by_base, by_battery), budget.corners)
        return Placed(prediction, lies, worst.within(lies.worst_mm), (looks[0], looks[1]))

    # -- looking -----------------------------------------------------------------------------------------------

    def _see_base(self, base: Base, expected: Pose) -> tuple[Pose, BaseMeasurement]:
        mount = self.config.mount_1.frame(self._look_1)
        seen = self._eyes.base(self.stop(self._look_1), base, mount.inverse() @ expected)
        return mount @ views.base_pose(self._planes[0], seen), seen

    def _second_edge(self, base: Base, robot_from_base: Pose, seen: BaseMeasurement) -> tuple[Edge, views.Deviation]:
        mounts = self.config.mount_1.frame(self._look_1), self.config.mount_1.frame(self._again_1)
        edge = self._eyes.edge(self.stop(self._again_1), base, mounts[1].inverse() @ robot_from_base)
        return edge, views.second_edge(self._planes[0], self.recipe.base, robot_from_base, (seen.edge, edge), mounts)

    def _see_battery(self, held: Battery, expected: Pose) -> tuple[Pose, BatteryMeasurement]:
        seen = self._eyes.battery(self.stop(self._look_2), held, self._look_2 @ expected)
        return self._look_2.inverse() @ views.battery_pose(self._planes[1], self.recipe.battery, seen), seen

    def _opposite(self, held: Battery, tool_from_battery: Pose) -> tuple[BatteryMeasurement, Pose]:
        seen = self._eyes.battery(self.stop(self._again_2), held, self._again_2 @ tool_from_battery, opposite=True)
        robot_from_battery = views.battery_pose(self._planes[1], self.recipe.battery.diagonal, seen)
        return seen, self._again_2.inverse() @ robot_from_battery


def _pose(place: Place) -> Pose:
    return Pose(place.x_mm, place.y_mm, math.remainder(place.t_deg, 360.0))
