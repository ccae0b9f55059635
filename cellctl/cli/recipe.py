"""`cellctl recipe ...`"""

from pathlib import Path
from typing import Any

import click

from cellctl.cli.options import (
    FILE,
    Greedy,
    Numbers,
    ask,
    end,
    option,
    settings,
    with_cell_if_any,
    with_config,
    with_json,
)

CORNERS = ("lower_left", "lower_right", "upper_left", "upper_right")


@click.group()
def recipe() -> None:
    """Check, list, choose and teach recipes."""


@recipe.command("check")
@click.argument("files", nargs=-1, required=True, type=FILE)
@with_json
def recipe_check(files: tuple[Path, ...], as_json: bool) -> None:
    """Check recipe files: FILE:LINE:COLUMN: what is wrong."""
    from cellctl.desk.commands import check_recipes

    end(check_recipes(files, as_json=as_json))


@recipe.command("list")
@with_config
@with_json
def recipe_list(config: Path, as_json: bool) -> None:
    """List the recipes of the cell."""
    from cellctl.desk.commands import list_folder

    list_folder(settings(config).paths.recipes, as_json=as_json)


@recipe.command("use")
@click.argument("name")
@with_config
@with_json
def recipe_use(name: str, config: Path, as_json: bool) -> None:
    """Work with the recipe NAME from the next start on."""
    ask(config, {"verb": "recipe_use", "name": name}, as_json=as_json)


@recipe.command("teach", cls=Greedy)
@click.argument("name")
@option("--base", type=FILE, multiple=True, required=True, help="Pictures of a good base, or folders of them.")
@option("--battery", type=FILE, multiple=True, required=True, help="Pictures of a good battery's corner.")
@option("--from", "origin", type=FILE, help="A recipe that has what pictures cannot show.")
@option("--battery-size", type=Numbers(2), help="WIDTHxHEIGHT of the battery in mm.")
@option("--seat", type=Numbers(3), help="X,Y,T of the seat's middle in the base frame, mm and degrees.")
@option("--corner", type=click.Choice(CORNERS), help="Which corner of the battery the pictures show.")
@option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="Any value of the recipe, as base.search_mm=1.5.")
@option("--hole", type=Numbers(3), help="U,V,R: the hole in the first picture of the base, px.")
@option("--edge", type=Numbers(4), help="U1,V1,U2,V2: the reference edge in the first picture of the base, px.")
@option("--battery-edge", type=Numbers(4), multiple=True, help="U1,V1,U2,V2: an edge of the battery, px; give both.")
@option("--mm-per-px", type=click.FloatRange(0.0005, 0.2), help="Size of a pixel on the part, for both cameras.")
@option("--bits", type=click.IntRange(8, 16), default=16, show_default=True, help="Bits that 16 bit pictures use.")
@option("--folder", type=FILE, help="Folder of recipes instead of the cell's.")
@option("--out", type=FILE, help="Folder for the drawn pictures.  [default: taught-NAME]")
@option("--force", is_flag=True, help="Replace a recipe of this name.")
@with_cell_if_any
@with_json
def recipe_teach(**options: Any) -> None:
    """Make the recipe NAME from pictures of a good base and a good battery.

    Hole, edges and corner are found by themselves and measured as in production; the recipe is written with a comment
    at every value, and only when it finds the parts in all the pictures. Nothing that pictures cannot show is made up.
    """
    from cellctl.lessons.teaching import order_of, teach_recipe

    end(teach_recipe(order_of(**options)))
