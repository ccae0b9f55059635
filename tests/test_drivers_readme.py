"""What drivers/README.md says is so."""

import re
import textwrap
import tomllib
from pathlib import Path

import pytest

import drivers.errors
from cellctl.config import RobotConfig
from cellctl.config_arm import ArmSpeeds
from cellctl.config_pulses import PulseConfig
from cellctl.faults import FAULTS
from drivers.errors import DeviceError
from drivers.rcx_codes import GROUPS, RCX2, RCX3
from tests.command_line import run
from tests.robot_bench import serial_wire_on, wire_on
from tests.robot_codes import table

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "drivers" / "README.md").read_text(encoding="utf-8")
NO_ROBOT = {"FrameLost", "Unavailable"}  # of cameras


def conversation(dialect):
    """What is said, and what is answered to each."""
    (text,) = re.findall(rf"```{dialect}\n(.*?)```", README, re.DOTALL)
    return [(first, rest) for first, *rest in (part.splitlines() for part in text.split("> ")[1:])]


async def test_an_rcx340_answers_as_it_says():
    async with wire_on(on=False) as (_, wire):
        for said, answers in conversation("rcx3"):
            assert await wire.ask(said, len(answers)) == [answer.removeprefix("< ") for answer in answers]


async def test_an_rcx240_on_its_serial_line_answers_as_it_says():
    async with serial_wire_on(baud=115200, dialect="rcx2") as (_, wire):
        for said, answers in conversation("rcx2"):
            assert await wire.ask(said, len(answers)) == [answer.removeprefix("< ") for answer in answers]


def test_the_table_of_codes_is_the_drivers():
    (told,) = re.findall(r"<!-- codes -->\n(.*?)\n<!-- /codes -->", README, re.DOTALL)
    assert told == table(), "renew it: python -m tests.robot_codes"


def test_every_group_of_the_codes_has_its_advice():
    advised = {
        int(group) for cell in re.findall(r"^\| ([\d, ]+) \| [a-z]", README, re.MULTILINE) for group in cell.split(",")
    }
    assert {group for group, _ in (*RCX3, *RCX2)} <= advised <= set(GROUPS)


def test_every_error_of_a_robot_is_told_with_its_code():
    told = dict(re.findall(r"^\| (\w\d) \| `(\w+)` \|", README, re.MULTILINE))
    kinds = {kind for kind in vars(drivers.errors).values() if isinstance(kind, type) and issubclass(kind, DeviceError)}
    robots = {kind for kind in kinds - {DeviceError} if kind.__name__ not in NO_ROBOT}
    assert told == {FAULTS[kind].code: kind.__name__ for kind in robots}


@pytest.mark.parametrize("command", sorted(set(re.findall(r"^    cellctl ([a-z]+(?: [a-z]+)?)", README, re.MULTILINE))))
def test_the_commands_it_names_are_there(command):
    words = command.split()
    ended = run(*(words if words[0] == "robot" else words[:1]), "--help")
    assert ended.code == 0
    assert ended.out.startswith("Usage: ")


@pytest.mark.parametrize("line", sorted(set(re.findall(r"`(\w+ = [^`]+)`", README))))
def test_the_keys_it_gives_are_those_of_a_robot_in_cell_toml(line):
    key = line.partition(" = ")[0]
    text = (ROOT / "deploy" / "cell.toml").read_text(encoding="utf-8")
    robot = tomllib.loads(text)["robot"] | {key: tomllib.loads(line)[key]}
    assert getattr(RobotConfig.model_validate(robot), key) == tomllib.loads(line)[key]


@pytest.mark.parametrize(
    "name", sorted(set(re.findall(r"`((?:cellctl|drivers|simulators|deploy|tests)/[\w./-]+)`", README)))
)
def test_the_files_it_names_exist(name):
    assert (ROOT / name).exists()


def table_of(name):
    """A table of cell.toml as the page has it."""
    (told,) = re.findall(rf"(\[robot\.{name}\]\n.*?)\n\n", README, re.DOTALL)
    return told


def test_the_speeds_it_names_are_keys_of_cell_toml():
    assert set(re.findall(r"\w+_per_s2?", table_of("speeds"))) == set(ArmSpeeds.model_fields)
    ArmSpeeds.model_validate(tomllib.loads(textwrap.dedent(table_of("speeds")))["robot"]["speeds"], strict=False)


def test_the_pulses_it_gives_are_pulses():
    found = tomllib.loads(textwrap.dedent(table_of("pulses")))["robot"]["pulses"]
    assert PulseConfig.model_validate(found).limits.per == tuple(found["per_deg_or_mm"])
