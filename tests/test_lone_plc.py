"""`cellctl simulate plc`: the PLC as a program of its own, for any client."""

import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from simulators.lone_plc import main
from tests.modbus_wire import frame


@contextmanager
def program(*arguments: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """The program and its port."""
    command = [sys.executable, "-m", "cellctl", "simulate", "plc", "--tcp", "127.0.0.1:0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        told = ""
        while "Ctrl-C" not in told:
            line = process.stdout.readline()
            assert line, told
            told += line
        found = re.search(r"Modbus TCP +127\.0\.0\.1:(\d+)", told)
        assert found is not None
        yield int(found[1]), process
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=10)


def ask(connection: socket.socket, pdu_hex: str, unit: int) -> str:
    connection.sendall(frame(7, bytes.fromhex(pdu_hex), unit=unit))
    return connection.recv(300)[7:].hex(" ")


def test_any_client_is_served_as_told_and_logged_and_a_person_may_press_the_emergency_stop(tmp_path: Path) -> None:
    log, person = tmp_path / "log", tmp_path / "person"
    with program("--unit", "9", "--without", "23", "--log", str(log), "--person", str(person)) as (port, process):
        with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
            assert ask(client, "0300650001", 9) == "03 02 01 00"  # the map version
            assert ask(client, "0300680001", 9) == "03 02 00 07"  # e-stop, guard and air are healthy
            assert ask(client, "170064000100000001020001", 9) == "97 01"
            assert ask(client, "0300650001", 3) == "83 0b"
            with socket.socket(socket.AF_UNIX) as at_hand, at_hand.makefile("rw") as lines:
                at_hand.connect(str(person))
                lines.write(json.dumps({"do": "inject", "component": "safety", "fault": "estop"}) + "\n")
                lines.flush()
                assert json.loads(lines.readline())["ok"]
            assert ask(client, "0300680001", 9) == "03 02 00 06"
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
    entries = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert [(entry["unit"], entry["request"][:2], entry["answer"][:2]) for entry in entries] == [
        (9, "03", "03"),
        (9, "03", "03"),
        (9, "17", "97"),
        (3, "03", "83"),
        (9, "03", "03"),
    ]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--unit", "0"], "'0' is not a unit id from 1 to 247"),
        (["--without", "7"], "invalid choice: 7"),
        (["--units", "some"], "invalid choice: 'some'"),
        (["--tcp", "here"], "'here' is not HOST:PORT"),
    ],
)
def test_wrong_arguments_are_told(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert said in capsys.readouterr().err


def test_a_port_that_is_taken_and_a_program_that_does_not_exist_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["--tcp", f"127.0.0.1:{taken.getsockname()[1]}"]) == 1
    assert "cannot listen: " in capsys.readouterr().err
    assert main(["--program", str(tmp_path / "none.st")]) == 1
    assert "none.st" in capsys.readouterr().err
