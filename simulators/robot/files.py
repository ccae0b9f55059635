"""READ and WRITE: programs, points, hands, shifts, pallets and more as text, out of and into the controller."""

from collections.abc import Callable
from dataclasses import replace

from simulators.robot.codes import Code, Refusal
from simulators.robot.dialect import AXES
from simulators.robot.framing import END_OF_FILE
from simulators.robot.handlers import Handlers
from simulators.robot.language.assignments import Assignment, PointTarget, TableTarget, VariableTarget, assignment
from simulators.robot.language.names import FileName
from simulators.robot.language.program import Source, parse_source
from simulators.robot.language.tokens import upper
from simulators.robot.language.values import Scope
from simulators.robot.machine import Machine, MachineScope
from simulators.robot.programs import Programs
from simulators.robot.refusals import Kind
from simulators.robot.settings import AXIS_DEFAULTS, DEFAULTS

MOST_LINES = 40_000
TARGETS = {"PNT": PointTarget, "HND": TableTarget, "SFT": TableTarget, "PLT": TableTarget, "VAR": VariableTarget}
TABLES = {"HND": "H", "SFT": "S", "PLT": "PL"}


class Upload:
    """A file on its way in; `end` puts it in its place, all of it or nothing."""

    def __init__(self, files: "Files", name: FileName) -> None:
        self._files, self._name = files, name
        self._lines: list[str] = []

    def take(self, line: str) -> bool:
        """One more line; True when the file is complete: at an empty line, at ^Z, or after the one line of a point."""
        text = line.removesuffix(chr(END_OF_FILE))
        if text.strip():
            self._lines.append(text)
        if len(self._lines) > MOST_LINES:
            raise Refusal(Code.MEMORY_FULL)
        return text is not line or not text.strip() or self._name.point is not None

    def end(self) -> None:
        """Raises Refusal when the file says something wrong."""
        self._files.put(self._name, self._lines)


class Files:
    """The controller's memory as files."""

    def __init__(self, machine: Machine, programs: Programs, handlers: Handlers) -> None:
        self._machine, self._programs, self._handlers = machine, programs, handlers
        self._readers: dict[str, Callable[[], list[str]]] = {
            "PGM": self._all_programs,
            "PNT": self._points,
            "HND": self._hands,
            "SFT": self._shifts,
            "PLT": self._pallets,
            "VAR": self._variables,
            "PRM": self._parameters,
            "DIR": self._directory,
            "LOG": self._log,
            "MEM": self._memory,
        }

    def read(self, name: FileName) -> list[str]:
        """The lines of a file; raises Refusal."""
        if name.program is not None:
            if name.program not in self._programs.sources:
                raise Refusal(Code.PROGRAM_MISSING)
            return _program(self._programs.sources[name.program])
        if name.point is not None:
            return [self._point(name.point)]
        reader = self._readers.get(name.kind)
        return reader() if reader is not None else []

    def write(self, name: FileName) -> Upload:
        """Begin to take a file in; raises Refusal."""
        self._machine.permit(Kind.PROGRAM)
        if name.kind != "PGM" and name.kind not in TARGETS:
            raise Refusal(Code.WRITING_PROHIBITED)
        return Upload(self, name)

    def put(self, name: FileName, lines: list[str]) -> None:
        """A whole file into its place; raises Refusal."""
        self._machine.permit(Kind.PROGRAM)
        if name.kind == "PGM":
            for source in [parse_source(name.program, part) for part in _parted(lines)]:
                self._programs.store(source)
            return
        scope = MachineScope(self._machine, strict=True)
        for entry in [_settled(self._entry(name, upper(line)), scope) for line in lines]:
            self._handlers.assign(entry, scope)

    def _entry(self, name: FileName, line: str) -> Assignment:
        entry = assignment(line)
        if entry is None or not isinstance(entry.target, TARGETS[name.kind]):
            raise Refusal(Code.INPUT_FORMAT)
        if isinstance(entry.target, TableTarget) and entry.target.kind != TABLES[name.kind]:
            raise Refusal(Code.INPUT_FORMAT)
        return entry

    # -- what a file says --------------------------------------------------------------------------------

    def _point(self, number: int) -> str:
        point = self._machine.tables.point(number)
        return f"P{number}={self._machine.dialect.point(point)}"

    def _points(self) -> list[str]:
        return [self._point(number) for number in sorted(self._machine.tables.points)]

    def _hands(self) -> list[str]:
        number = self._machine.dialect.number
        return [
            f"H{k}={number(hand.turn)} {number(hand.length_mm)} {number(hand.height_mm)}{' R' if hand.on_r else ''}"
            for k, hand in sorted(self._machine.tables.hands.items())
        ]

    def _shifts(self) -> list[str]:
        number = self._machine.dialect.number
        shifts = sorted(self._machine.tables.shifts.items())
        return [f"S{k}={' '.join(number(value) for value in shift)}" for k, shift in shifts]

    def _pallets(self) -> list[str]:
        pallets = sorted(self._machine.tables.pallets.items())
        return [f"PL({k})={pallet.nx},{pallet.ny},{pallet.nz}" for k, pallet in pallets]

    def _variables(self) -> list[str]:
        quote = '"'
        return [
            f"{name}={quote}{value}{quote}" if isinstance(value, str) else f"{name}={value}"
            for name, value in self._machine.variables.items()
        ]

    def _parameters(self) -> list[str]:
        settings = self._machine.settings
        whole = [f"{name}={settings.number(name)}" for name in DEFAULTS]
        return whole + [
            f"{name}({axis})={settings.axes(name)[axis - 1]}" for name in AXIS_DEFAULTS for axis in range(1, AXES + 1)
        ]

    def _all_programs(self) -> list[str]:
        return [line for source in self._programs.sources.values() for line in _program(source)]

    def _directory(self) -> list[str]:
        return [f"{k},{s.name},{len(s.lines)}" for k, s in enumerate(self._programs.sources.values(), 1)]

    def _log(self) -> list[str]:
        code = self._machine.dialect.code
        return [f"{report.at_s:.2f},{code(report.code)}" for report in self._machine.alarms.history]

    def _memory(self) -> list[str]:
        lines = sum(len(source.lines) for source in self._programs.sources.values())
        return [f"PGM,{lines}", f"PNT,{len(self._machine.tables.points)}"]


def _settled(entry: Assignment, scope: Scope) -> Assignment:
    """The same with its value known, so that nothing can go wrong half way through a file."""
    value = entry.value(scope)
    return replace(entry, value=lambda scope: value)


def _program(source: Source) -> list[str]:
    head = [f"NAME={source.name}"]
    return head + ([f"PGN={source.number}"] if source.number is not None else []) + list(source.lines)


def _parted(lines: list[str]) -> list[list[str]]:
    """One part for each program in a file."""
    parts: list[list[str]] = [[]]
    for line in lines:
        if upper(line).replace(" ", "").startswith("NAME=") and parts[-1]:
            parts.append([])
        parts[-1].append(line)
    return parts
