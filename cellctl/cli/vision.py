"""`cellctl vision ...`"""

from pathlib import Path
from typing import Any

import click

from cellctl.cli.options import FILE, end, option, with_cell_if_any, with_json


@click.group()
def vision() -> None:
    """Try the finders on pictures from files."""


@vision.command("test")
@click.argument("pictures", nargs=-1, required=True, type=FILE)
@option("--recipe", type=FILE, required=True, help="The recipe file whose features are looked for.")
@option("--camera", type=click.Choice(["1", "2", "auto"]), default="auto", show_default=True, help="Whose pictures.")
@option("--out", type=FILE, help="Folder for the annotated pictures.")
@option("--search-mm", type=click.FloatRange(0.0, 10.0, min_open=True), help="Search distance instead of the recipe's.")
@option("--mm-per-px", type=click.FloatRange(0.0005, 0.2), help="Size of a pixel on the part, for both cameras.")
@option("--bits", type=click.IntRange(8, 16), default=16, show_default=True, help="Bits that 16 bit pictures use.")
@with_cell_if_any
@with_json
def vision_test(pictures: tuple[Path, ...], recipe: Path, camera: str, config: Path | None, **options: Any) -> None:
    """Run a recipe's finders over picture files and folders (PNG, TIFF, BMP, JPEG).

    The part is expected as the recipe says, about the middle of the picture. Ends with 1 when anything was refused.
    """
    from cellctl.desk.vision import CAMERAS, Order, try_pictures

    end(try_pictures(Order(pictures, recipe, config, CAMERAS[camera], **options)))
