"""`cellctl plc ...`"""

from pathlib import Path

import click

from cellctl.cli.options import end, option, settings, with_config, with_json


@click.group()
def plc() -> None:
    """Look at the PLC, and check it against the contract."""


@plc.command("watch")
@option("--once", is_flag=True, help="Show the map once and end.")
@option("--period", type=click.FloatRange(0.05, 60), default=0.5, show_default=True, help="Seconds between two looks.")
@option("--direct", is_flag=True, help="Ask the PLC itself, also when the daemon runs; needs a second connection.")
@option("--wire", is_flag=True, help="Show the packets on the wire instead of the map.")
@with_config
@with_json
def plc_watch(once: bool, period: float, direct: bool, wire: bool, config: Path, as_json: bool) -> None:
    """Show the live register map with names, values and ages, until Ctrl-C. Nothing is ever written.

    The running daemon is asked for what it sees: that costs the PLC nothing. When none runs, or with --direct, the PLC
    is read over a connection of its own, by reading function codes only, so that nobody's session is touched.
    """
    from cellctl.desk.plc_watch import Wanted, watch_plc

    wanted = Wanted(once=once, period_s=period, direct=direct, wire=wire, as_json=as_json)
    end(watch_plc(settings(config), wanted))


@plc.command("check")
@option("--move", is_flag=True, help="Try what moves the conveyor and switches the vacuum, too.")
@option("--yes", is_flag=True, help="Do not ask before something moves.")
@with_config
@with_json
def plc_check(move: bool, yes: bool, config: Path, as_json: bool) -> None:
    """Check a PLC against the contract, point by point; takes about six seconds.

    First it only reads. When the PLC serves nobody it then opens a session of its own, with which nothing moves: stop
    the daemon before. It speaks through another Modbus implementation than the daemon, so that both cannot be wrong in
    the same way. Robot enable drops for a moment, and the latched safety bits are reset.

    Exit codes: 0 all passed, 1 a point failed, 3 none failed but some could not be tried.
    """
    from cellctl.desk.plc_check import check_plc

    if move and not yes:
        click.confirm(
            "The conveyor will run, carriers will come and go. Is everybody clear of it?", abort=True, err=True
        )
    end(check_plc(settings(config), move=move, as_json=as_json))
