"""The finders of a recipe on pictures from files: each is found, or refused with the check that failed."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

from cellctl.assembly import views
from cellctl.geometry import Mm, Pose, Px, wrap_deg
from cellctl.pictures.files import Picture
from cellctl.pictures.scale import Scale
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement, NotFound, find_base, find_battery
from cellctl.vision.features import Edge, ExpectedCircle, ExpectedEdge, Pixels, Search

Camera = Literal[1, 2]
PARTS: dict[Camera, str] = {1: "base", 2: "battery"}


class Found(NamedTuple):
    """What was measured: the mark is the hole's centre or the battery's corner, the edge gives the direction."""

    seen: BaseMeasurement | BatteryMeasurement
    mark_px: Px
    sd_px: float
    edge: Edge
    pose: Pose  # in the frame of the scale


class Task(NamedTuple):
    """What to look for in the pictures of one camera."""

    camera: Camera
    scale: Scale
    pose: Pose  # where the part is expected
    mark: Mm  # the mark in the part's frame
    expected: tuple[ExpectedCircle | ExpectedEdge, ...]
    find: Callable[[Pixels], Found]


class Trial(NamedTuple):
    """What became of one picture: found, or refused."""

    path: Path
    notes: tuple[str, ...]  # what was done to the file's picture
    task: Task
    found: Found | None
    refused: NotFound | None
    took_ms: float

    @property
    def offset(self) -> Pose | None:
        """How far the mark lies from its expected place, in the part's frame, and how far the part is turned."""
        if self.found is None:
            return None
        found, mark = self.task.pose.inverse() @ self.found.pose, self.task.mark
        at = found.point(*mark)
        return Pose(at.x_mm - mark.x_mm, at.y_mm - mark.y_mm, wrap_deg(found.t_deg))


def tasks(recipe: Recipe, scales: tuple[Scale, Scale], search_mm: float | None = None) -> dict[Camera, Task]:
    """What the recipe looks for in the pictures of either camera; another search distance may be given."""
    return {1: _base(recipe, scales[0], search_mm), 2: _battery(recipe, scales[1], search_mm)}


def _base(recipe: Recipe, scale: Scale, search_mm: float | None) -> Task:
    part, plane = recipe.base, scale.plane
    pose = scale.expected(Mm(part.view_x_mm, part.view_y_mm))
    expected = views.expect_base(plane, part, pose)
    limits, search = views.limits_px(plane, recipe), _search(views.search_px(plane, part), search_mm, plane.mm_per_px)

    def find(pixels: Pixels) -> Found:
        seen = find_base(pixels, *expected, search, limits)
        return Found(seen, seen.circle.centre, seen.circle.sd_px, seen.edge, views.base_pose(plane, seen))

    return Task(1, scale, pose, Mm(0.0, 0.0), expected, find)


def _battery(recipe: Recipe, scale: Scale, search_mm: float | None) -> Task:
    part, plane = recipe.battery, scale.plane
    pose = scale.expected(views.battery_view_mm(part))
    expected = views.expect_battery(plane, part, pose)
    limits, search = views.limits_px(plane, recipe), _search(views.search_px(plane, part), search_mm, plane.mm_per_px)

    def find(pixels: Pixels) -> Found:
        seen = find_battery(pixels, *expected, search, limits)
        edge = views.direction_edge(part, seen)
        return Found(seen, seen.corner, seen.corner_sd_px, edge, views.battery_pose(plane, part, seen))

    return Task(2, scale, pose, views.corner_mm(part), expected, find)


def _search(by_recipe: Search, search_mm: float | None, mm_per_px: float) -> Search:
    return by_recipe if search_mm is None else by_recipe._replace(position_px=search_mm / mm_per_px)


def try_picture(picture: Picture, task: Task) -> Trial:
    """Look for the task's part in a picture."""
    found: Found | None = None
    refused: NotFound | None = None
    began_s = time.perf_counter()
    try:
        task.scale.check(picture.pixels)
        found = task.find(picture.pixels)
    except NotFound as error:
        refused = error
    except ValueError as error:  # an expectation that no picture can keep: a wrong scale
        refused = NotFound("scale", f"{error}; is the size of a pixel right ({task.scale.source})?")
    return Trial(picture.path, picture.notes, task, found, refused, (time.perf_counter() - began_s) * 1000)


def try_either(picture: Picture, either: dict[Camera, Task]) -> Trial:
    """Look for whichever part a picture shows; one that shows neither or both is refused."""
    trials = [try_picture(picture, task) for task in either.values()]
    found = [trial for trial in trials if trial.found is not None]
    if len(found) == 1:
        return found[0]
    said = "; ".join(f"no {PARTS[trial.task.camera]} ({trial.refused})" for trial in trials)
    both = "it could be of either camera: say which (--camera)"
    return trials[0]._replace(found=None, refused=NotFound("camera", both if found else said))
