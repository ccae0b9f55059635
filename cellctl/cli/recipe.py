"""`cellctl recipe ...`"""

from pathlib import Path

import click

from cellctl.cli.options import FILE, ask, end, job, option, settings, with_config, with_json


@click.group()
def recipe() -> None:
    """Check, list, choose and teach recipes."""


@recipe.command("check")
@click.argument("files", nargs=-1, required=True, type=FILE)
@with_json
def recipe_check(files: tuple[Path, ...], as_json: bool) -> None:
    """Check recipe files: FILE:LINE:COLUMN: what is wrong."""
    from cellctl.commands import check_recipes

    end(check_recipes(files, as_json=as_json))


@recipe.command("list")
@with_config
@with_json
def recipe_list(config: Path, as_json: bool) -> None:
    """List the recipes of the cell."""
    from cellctl.commands import list_folder

    list_folder(settings(config).paths.recipes, as_json=as_json)


@recipe.command("use")
@click.argument("name")
@with_config
@with_json
def recipe_use(name: str, config: Path, as_json: bool) -> None:
    """Work with the recipe NAME from the next start on."""
    ask(config, {"verb": "recipe_use", "name": name}, as_json=as_json)


@recipe.command("teach")
@option("--repeats", type=click.IntRange(1, 100), default=5, show_default=True, help="How often it is measured.")
@with_config
@with_json
def recipe_teach(repeats: int, config: Path, as_json: bool) -> None:
    """Teach the recipe in use with a golden assembly: a base with a battery seated by hand."""
    job(config, {"verb": "teach", "repeats": repeats}, as_json=as_json)
