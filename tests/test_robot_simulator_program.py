"""`cellctl simulate robot`: a controller as a program of its own, for any client."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

from simulators.robot.__main__ import main
from simulators.robot.options import Options, with_settings


@contextmanager
def running(*arguments):
    """The program, and what it printed about where it is to be found."""
    command = [sys.executable, "-m", "cellctl", "simulate", "robot", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    told = []
    try:
        for line in process.stdout:
            told.append(line)
            if "Ctrl-C" in line:
                break
        yield process, "".join(told)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(10)
        process.stdout.close()


def ask(connection, command, until):
    connection.sendall(f"{command}\r\n".encode())
    received = b""
    while not received.endswith(until):
        received += connection.recv(100)
    return received.decode()


def test_an_rcx340_on_the_network_with_a_person_beside_it(tmp_path):
    with running(
        *("--tcp", "127.0.0.1:0", "--speed", "20", "--option", "after_stop=end"),
        *("--person", str(tmp_path / "p"), "--log", str(tmp_path / "log")),
    ) as (process, told):
        assert "RCX340 (rcx3) with a YK400XG" in told
        port = int(re.search(r"tcp://127\.0\.0\.1:(\d+)", told)[1])
        with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
            ask(connection, "", b"\r\n\r\n")
            assert ask(connection, "@MOTOR ON", b"END\r\n") == "RUN\r\nEND\r\n"
            with socket.socket(socket.AF_UNIX) as person, person.makefile("rw") as lines:
                person.connect(str(tmp_path / "p"))

                def do(**verb):
                    lines.write(json.dumps(verb) + "\n")
                    lines.flush()
                    return json.loads(lines.readline())

                assert do(do="inject", component="safety", fault="estop") == {"ok": True}
                assert ask(connection, "@?ALM", b"OK\r\n") == "12.600\r\nOK\r\n"
                assert "no fault 'bang'" in do(do="inject", component="robot", fault="bang")["error"]
                assert "cannot inject cup bang" in do(do="inject", component="cup", fault="bang")["error"]
                assert not do(do="state")["moving"]
                assert [entry["kind"] for entry in do(do="log")["log"]].count("alarm") == 1
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "log").read_text().splitlines()]
    assert "joined" in kinds
    assert "alarm" in kinds


def test_an_rcx240_on_a_serial_line(tmp_path):
    link = tmp_path / "robot"
    with running("--dialect", "rcx2", "--serial", "--link", str(link), "--speed", "10") as (_, told):
        assert f"serial:{link}?baud=9600&parity=odd&flow=xonxoff" in told
        fd = os.open(link, os.O_RDWR | os.O_NOCTTY)
        os.write(fd, b"@?MOD\r\n")
        received = b""
        while not received.endswith(b"\r\n"):
            received += os.read(fd, 100)
        os.close(fd)
    assert received == b"AUTO\r\n"
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--tcp", "nowhere"], "'nowhere' is not HOST:PORT"),
        (["--option", "colour=red"], "'colour=red' is no option: write NAME=VALUE with one of pulse_scale,"),
        (["--option", "after_stop=maybe"], "option after_stop: 'maybe' is none of ng, end"),
        (["--option", "dead_man_s=long"], "option dead_man_s: 'long' is no number"),
        (["--option", "busy=9.99"], "there is no code '9.99', write group.class"),
        (["--serial", "300"], "invalid choice: 300"),
    ],
)
def test_a_wrong_argument_is_named_with_what_would_be_right(arguments, complaint, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["--tcp", f"127.0.0.1:{taken.getsockname()[1]}"]) == 1
    assert "cannot listen: " in capsys.readouterr().err


def test_every_kind_of_option_can_be_given_as_text():
    settings = ["padded_codes=true", "where_fields=9", "silence_min=2.5", "echo=false", "config=X", "telnet=1"]
    options = with_settings(Options(), settings)
    assert (options.padded_codes, options.where_fields, options.silence_min) == (True, 9, 2.5)
    assert (options.echo, options.config, options.telnet) == (False, "X", True)
