"""The page for the PLC engineer says what program and driver say: registers, terminals, constants, fault numbers."""

import re
from pathlib import Path

import pytest

from drivers.plc_registers import FAULT_NAMES, MAP_VERSION, RESULT_NAMES, Command, PlcState
from drivers.plc_tags import CELL_TAGS, PLC_TAGS, Tag
from simulators.plc_program import DELIVERED
from simulators.plc_wiring import OUTPUTS
from simulators.st.declarations import parse
from simulators.st.literals import US_PER
from simulators.st.nodes import Unit, Variable

PAGE = Path("deploy/plc/README.md").read_text(encoding="utf-8")
SOURCE = DELIVERED.read_text(encoding="utf-8")
UNITS: dict[str, Unit] = {unit.name: unit for unit in parse(SOURCE)}
LOCATED = {variable.address: variable for variable in UNITS["Cell"].variables if variable.address}
CHOICES: dict[int, dict[int, str]] = {
    4: {int(command): command.words for command in Command},
    103: {int(state): state.words for state in PlcState},
    109: RESULT_NAMES,
}
COMMENTS = dict(re.findall(r"(\w+) AT %\w+(?:\.\d)? : \w+;\s*\(\* (.*?) \*\)", SOURCE))


def block(name: str) -> str:
    """What stands between the marks of that name."""
    (found,) = re.findall(rf"<!-- {name} -->\n(.*?)\n<!-- end -->", PAGE, re.DOTALL)
    return str(found)


def meaning(tag: Tag) -> str:
    """The tag's name with its unit, its bits or its choices."""
    shown = tag.show([0, 0])
    if isinstance(shown, dict):
        return f"{tag.name}: " + ", ".join(f"bit {bit} {name}" for bit, name in enumerate(shown))
    if tag.address in CHOICES:
        return f"{tag.name}: " + ", ".join(f"{number} {name}" for number, name in CHOICES[tag.address].items())
    return f"{part_of_word(tag)}{tag.name}" + (f" in {raw_unit(tag)}" if tag.unit else "")


def part_of_word(tag: Tag) -> str:
    """Which byte of the register it is."""
    return {1: "high byte ", 2: "low byte "}.get(tag.show([0x0102, 0]), "")  # type: ignore[arg-type]


def raw_unit(tag: Tag) -> str:
    """What one count in the register is, and whether it has a sign."""
    tenths, signed = tag.show([1, 0]) == 0.1, tag.show([0xFFFF, 0]) == -0.1
    return f"{'0.1 ' if tenths else ''}{tag.unit}{', signed' if signed else ''}"


def registers() -> str:
    """The register table."""
    rows = ["| register | in `cell.st` | |", "|---|---|---|"]
    tags: dict[int, list[Tag]] = {}
    for tag in CELL_TAGS + PLC_TAGS:
        tags.setdefault(tag.address, []).append(tag)
    for address, variable in LOCATED.items():
        if address.startswith("%MW"):
            number = int(address[3:])
            said = "; ".join(meaning(tag) for tag in tags.get(number, [])) or "its low word"
            rows.append(f"| {number} | {variable.name} | {said} |")
    return "\n".join(rows)


def terminals(letter: str) -> str:
    """The table of inputs or outputs."""
    rows = ["| terminal | in `cell.st` | |", "|---|---|---|"]
    of_letter = [variable for address, variable in LOCATED.items() if address.startswith(f"%{letter}")]
    rows += [f"| {each.address} | {each.name} | {COMMENTS[each.name]} |" for each in of_letter]
    return "\n".join(rows)


def constants() -> str:
    """The constants that a cell may need otherwise; those of the client's watch belong to the contract."""
    rows = ["| where | constant | value |", "|---|---|---|"]
    for unit in UNITS.values():
        for each in unit.variables:
            chosen = each.type_name == "TIME" or each.name.startswith(("VACUUM_", "AT_"))
            if each.constant and chosen and each.name != "LONG_TIME" and unit.name != "ClientWatch":
                rows.append(f"| {unit.name} | {each.name} | {value_of(each)} |")
    return "\n".join(rows)


def value_of(variable: Variable) -> str:
    """As a person writes it."""
    assert variable.initial is not None
    if variable.type_name != "TIME":
        return str(variable.initial.value)
    us = variable.initial.value
    unit = next(name for name in US_PER if us % US_PER[name] == 0)
    return f"{us // US_PER[unit]} {unit}"


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("registers", registers()),
        ("inputs", terminals("I")),
        ("outputs", terminals("Q")),
        ("constants", constants()),
    ],
)
def test_the_tables_of_the_page_are_those_of_program_and_driver(name: str, table: str) -> None:
    assert block(name) == table


def test_every_register_of_the_driver_is_in_the_program_and_no_other() -> None:
    driver = {tag.address for tag in CELL_TAGS + PLC_TAGS} | {112}
    program = {int(address[3:]) for address in LOCATED if address.startswith("%MW")}
    assert program == driver
    assert f"MAP_VERSION : WORD := 16#{MAP_VERSION:04X};" in SOURCE


def test_every_output_of_the_program_is_wired_in_the_simulated_cell() -> None:
    assert {address for address in LOCATED if address.startswith("%Q")} == OUTPUTS


def test_the_fault_numbers_of_the_page_are_those_that_the_program_sets() -> None:
    told = {int(number) for number in re.findall(r"^\| (\d) \| ", PAGE.partition("## Fault numbers")[2], re.MULTILINE)}
    assert told == {int(number) for number in re.findall(r"faultNumber := ([1-9])", SOURCE)}
    assert told == FAULT_NAMES.keys() - {0}


@pytest.mark.parametrize("command", sorted(set(re.findall(r"cellctl ((?:plc|simulate)[ \w]*)", PAGE))))
def test_the_commands_that_the_page_names_exist(command: str) -> None:
    from cellctl.__main__ import cli

    words = command.split()
    assert words[0] in cli.commands
    if words[0] == "plc":
        assert words[1] in cli.commands["plc"].commands  # type: ignore[attr-defined]
