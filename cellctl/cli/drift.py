"""`cellctl drift`"""

from pathlib import Path

import click

from cellctl.cli.options import ask, end, option, settings, with_config, with_json


@click.command()
@option("--last", type=click.IntRange(1, 2000), default=20, show_default=True, help="How many units are listed.")
@option("--anew", is_flag=True, help="Forget what was found so far, and the correction; at rest only.")
@with_config
@with_json
def drift(last: int, anew: bool, config: Path, as_json: bool) -> None:
    """Show how batteries lie off, unit by unit, whether that drifts, and why."""
    if anew:
        ask(config, {"verb": "drift_anew"}, as_json=as_json)
        return
    from cellctl.desk.drift import show
    from cellctl.journal_file import FILE_NAME

    end(show(settings(config).paths.state / FILE_NAME, last, as_json=as_json))
