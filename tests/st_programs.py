"""Small Structured Text programs for the tests of the interpreter."""

from simulators.st.library import TimeBase
from simulators.st.machine import Machine


def program(body: str, variables: str = "", before: str = "") -> str:
    """The text of a program with these statements."""
    return f"{before}\nPROGRAM Main\n{variables}\n{body}\nEND_PROGRAM\n"


def machine(body: str, variables: str = "", before: str = "", time: TimeBase | None = None) -> Machine:
    """A PLC that executes these statements."""
    return Machine(program(body, variables, before), time=time or TimeBase())


def evaluated(expression: str, kind: str, variables: str = "") -> int | bool:
    """What an expression of that type yields."""
    made = machine(f"result := {expression};", f"VAR result : {kind}; END_VAR\n{variables}")
    made.scan()
    return made["result"]
