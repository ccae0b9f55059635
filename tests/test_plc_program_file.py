"""The file of the PLC program: refused with its place when it is wrong, stopped when it fails, fast when it runs."""

import re
import subprocess
import sys
import timeit
from functools import partial
from pathlib import Path

import pytest

from drivers.plc import Plc
from simulators.plc_program import DELIVERED, ON_WALL_TIME, PlcProgram
from simulators.st.errors import StError
from tests.plc_belt import powered, running
from tests.plc_bench import (
    Bench,
    live,
)


def test_a_program_with_other_terminals_is_refused_by_name(tmp_path: Path) -> None:
    other = tmp_path / "other.st"
    other.write_text(DELIVERED.read_text().replace("airInput AT %IX0.6", "airInput AT %IX0.7"))
    with pytest.raises(StError, match=r"1:1: addresses that are not wired, or lack: %IX0\.6, %IX0\.7"):
        Bench(source=other)


def test_a_program_with_a_register_outside_the_map_is_refused_by_name(tmp_path: Path) -> None:
    other = tmp_path / "other.st"
    other.write_text(DELIVERED.read_text().replace("AT %MW119", "AT %MW19"))
    with pytest.raises(StError, match=r"addresses that are not wired, or lack: %MW19$"):
        Bench(source=other)


def test_a_program_that_is_wrong_is_refused_with_its_file_and_place(tmp_path: Path) -> None:
    other = tmp_path / "other.st"
    other.write_text(DELIVERED.read_text().replace("enableOutput := enable;", "enableOutput := safety;"))
    with pytest.raises(StError, match=rf"{re.escape(str(other))}:\d+:17: enableOutput is BOOL \(got WORD\)"):
        Bench(source=other)


@pytest.mark.parametrize("block", ON_WALL_TIME)
def test_a_program_without_a_block_that_runs_on_wall_time_is_refused(block: str, tmp_path: Path) -> None:
    other = tmp_path / "other.st"
    other.write_text(re.sub(rf"\b{block}\b", f"{block}X", DELIVERED.read_text()))
    with pytest.raises(StError, match=f"there is no function block {block} in the PROGRAM"):
        Bench(source=other)


async def test_a_program_that_fails_puts_the_plc_into_stop_until_power_comes_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.st"
    failing = "age := age / (1 - UINT_TO_UDINT(cellGood)); plcMapVersion :="
    other.write_text(DELIVERED.read_text().replace("plcMapVersion :=", failing))
    lamps = {"red": False, "amber": False, "green": True, "buzzer": False}
    async with (
        powered(program=partial(PlcProgram, source=other)) as (world, server),
        running(Plc("127.0.0.1", server.port)) as plc,
    ):
        await plc.ready(within_s=2)
        plc.show(machine_state=6, good=1, rejected=0, **lamps)
        assert "heartbeat (register 100) stands" in await plc.unsafe()
        assert not world.robot_enable
        assert server.fault is not None
        assert re.search(
            rf"{re.escape(str(other))}:\d+:\d+: division by zero; it is in STOP\n", capsys.readouterr().err
        )
        plc.show(machine_state=6, good=2, rejected=0, **lamps)
        server.inject("reboot")
        await plc.ready(within_s=3)


def test_a_scan_is_cheap() -> None:
    bench = live()
    best_s = min(timeit.repeat(lambda: bench.beat(20), number=1, repeat=15)) / 20
    assert best_s < 0.0003


def test_a_simulated_cell_says_what_is_wrong_with_the_program_that_it_is_given(tmp_path: Path) -> None:
    other = tmp_path / "other.st"
    other.write_text("PROGRAM Cell\nx := 1;\nEND_PROGRAM")
    command = (sys.executable, "-m", "simulators", "--plc", "127.0.0.1:0", "--plc-program", str(other))
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (1, f"{other}:2:1: x is not declared\n")
