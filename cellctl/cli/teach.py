"""`cellctl teach`"""

from pathlib import Path

import click

from cellctl.cli.options import job, option, with_config, with_json


@click.command()
@option("--repeats", type=click.IntRange(1, 100), default=5, show_default=True, help="Seatings of each pair.")
@option("--pairs", type=click.IntRange(1, 20), default=1, show_default=True, help="Golden pairs of base and battery.")
@with_config
@with_json
def teach(repeats: int, pairs: int, config: Path, as_json: bool) -> None:
    """Teach the recipe in use with golden assemblies: bases with batteries seated by hand."""
    job(config, {"verb": "teach", "repeats": repeats, "pairs": pairs}, as_json=as_json)
