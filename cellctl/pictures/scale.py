"""What pixels of a picture file mean in millimetres: by the calibration, cell.toml, the recipe, or an option.

Without a calibration camera 1 is taken to see its part from above and camera 2 from below, as in the drawing of the
cell, and directions count from the picture's own axes.
"""

from typing import NamedTuple

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config import CellConfig
from cellctl.faults import NotCalibrated
from cellctl.geometry import Mm, Pose, Px
from cellctl.learnt.calibrations import camera_config, read_doubtful
from cellctl.learnt.references import Eye
from cellctl.recipe import Recipe
from cellctl.recipe_light import PictureView
from cellctl.vision.features import NotFound, Pixels

EYES: tuple[Eye, Eye] = ("camera-1", "camera-2")
Size = tuple[int, int]  # width and height in px


class Scale(NamedTuple):
    """Where a part should lie in the pictures of one camera, and what a pixel is."""

    plane: PlaneMap  # px <-> mm in a frame seen from above
    size: Size
    turn_deg: float  # direction of the part's x axis in that frame
    oriented: bool  # the frame is the robot's, or the tool's at R = 0
    source: str

    @property
    def middle(self) -> Px:
        """The middle of the picture."""
        return Px((self.size[0] - 1) / 2, (self.size[1] - 1) / 2)

    @property
    def seen_from_above(self) -> bool:
        """Whether the camera looks down."""
        return self.plane.mirrored()

    def expected(self, view: Mm) -> Pose:
        """Pose of a part that shows this point of its own frame in the middle of the picture."""
        middle, turned = self.plane.mm_at(self.middle), Pose(0.0, 0.0, self.turn_deg)
        point = turned.point(*view)
        return Pose(middle.x_mm - point.x_mm, middle.y_mm - point.y_mm, self.turn_deg)

    def check(self, pixels: Pixels) -> None:
        """Raises NotFound when a picture has another size."""
        size = pixels.shape[1], pixels.shape[0]
        if size != self.size:
            raise NotFound("size", f"{size[0]} x {size[1]} px, expected are {self.size[0]} x {self.size[1]} px")


def plain(
    size: Size, mm_per_px: float, *, from_above: bool, turn_deg: float = 0.0, source: str = "--mm-per-px"
) -> Scale:
    """A camera without tilt and distortion; millimetres count from the picture's middle, x along +u."""
    px = 1.0 / mm_per_px
    middle = (size[0] - 1) / 2, (size[1] - 1) / 2
    matrix = ((px, 0.0), (0.0, -px if from_above else px))
    return Scale(PlaneMap(matrix, middle, 0.0, middle), size, turn_deg, oriented=False, source=source)


def of_option(size: Size, mm_per_px: float) -> tuple[Scale, Scale]:
    """Both cameras show so much of their parts per pixel."""
    return plain(size, mm_per_px, from_above=True), plain(size, mm_per_px, from_above=False)


def untilted(scale: Scale) -> Scale:
    """The same size of a pixel on the picture's own axes."""
    return plain(scale.size, scale.plane.mm_per_px, from_above=scale.seen_from_above)


def of_recipe(recipe: Recipe) -> tuple[Scale, Scale] | None:
    """As in the pictures that the recipe was taught from; None when it was not taught from pictures."""
    if recipe.pictures is None:
        return None
    base, battery = (_of_view(view) for view in (recipe.pictures.base, recipe.pictures.battery))
    return base, battery


def _of_view(view: PictureView) -> Scale:
    return plain(
        (view.width_px, view.height_px),
        view.mm_per_px,
        from_above=view.seen_from == "above",
        turn_deg=view.turn_deg,
        source="the pictures that the recipe was taught from",
    )


def of_cell(config: CellConfig) -> tuple[Scale, Scale]:
    """By the cell's calibrations (also by old ones), else by cell.toml."""
    base, battery = (_of_camera(config, eye) for eye in EYES)
    return base._replace(turn_deg=config.positions.station.t_deg) if base.oriented else base, battery


def _of_camera(config: CellConfig, eye: Eye) -> Scale:
    camera = camera_config(config, eye)
    size = camera.view_width_px, camera.view_height_px
    try:
        calibration = read_doubtful(config, eye)
    except NotCalibrated:
        return plain(size, camera.mm_per_px, from_above=eye == "camera-1", source=f"cell.toml: {eye} is not calibrated")
    day = calibration.made_at.date().isoformat()
    return Scale(calibration.plane, size, 0.0, oriented=True, source=f"calibration of {eye} of {day}")
