"""The PackML states of the cell, and every way between them (ISA-TR88.00.02, 2022 edition).

Rule 1: all transitions are in TRANSITIONS; nothing else may decide which state follows.
Rule 2: no device is known here; what is done in a state is in cell.py.

The numbers are the standard's, so a plant system reads them without a translation. The standard lets a machine
say where Hold is honoured besides Execute and Suspended: here also in Starting, Unholding, Suspending and
Unsuspending, because a fault that needs a person may be found on the way as well.
"""

from enum import Enum, IntEnum


class State(IntEnum):
    """Where the cell is."""

    CLEARING = 1
    STOPPED = 2
    STARTING = 3
    IDLE = 4
    SUSPENDED = 5
    EXECUTE = 6
    STOPPING = 7
    ABORTING = 8
    ABORTED = 9
    HOLDING = 10
    HELD = 11
    UNHOLDING = 12
    SUSPENDING = 13
    UNSUSPENDING = 14
    RESETTING = 15
    COMPLETING = 16
    COMPLETE = 17

    @property
    def title(self) -> str:
        """The name as people read it: "Execute"."""
        return self.name.capitalize()


class Command(IntEnum):
    """What a person, the PLC or a fault may ask for."""

    RESET = 1
    START = 2
    STOP = 3
    HOLD = 4
    UNHOLD = 5
    SUSPEND = 6
    UNSUSPEND = 7
    ABORT = 8
    CLEAR = 9
    COMPLETE = 10

    @property
    def title(self) -> str:
        """The name as people type it: "start"."""
        return self.name.lower()


class StateComplete(Enum):
    """What an acting state says when its work is done. Not an IntEnum: it must never equal a command."""

    SC = "SC"

    @property
    def title(self) -> str:
        """The standard's abbreviation: "SC"."""
        return self.name


class Mode(IntEnum):
    """What the cell may be used for now."""

    PRODUCTION = 1
    MAINTENANCE = 2
    MANUAL = 3

    @property
    def title(self) -> str:
        """The name as people read it: "Production"."""
        return self.name.capitalize()


SC = StateComplete.SC
Event = Command | StateComplete

NOT_ABORTABLE = frozenset({State.ABORTING, State.ABORTED})
NOT_STOPPABLE = NOT_ABORTABLE | {State.CLEARING, State.STOPPING, State.STOPPED}
HOLDABLE = frozenset(
    {State.EXECUTE, State.SUSPENDED, State.STARTING, State.UNHOLDING, State.SUSPENDING, State.UNSUSPENDING}
)
COMPLETABLE = frozenset({State.EXECUTE, State.HELD, State.SUSPENDED})
MODE_CHANGES = frozenset({State.STOPPED, State.IDLE, State.ABORTED})

TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.ABORTED, Command.CLEAR): State.CLEARING,
    (State.CLEARING, SC): State.STOPPED,
    (State.STOPPED, Command.RESET): State.RESETTING,
    (State.RESETTING, SC): State.IDLE,
    (State.IDLE, Command.START): State.STARTING,
    (State.STARTING, SC): State.EXECUTE,
    (State.EXECUTE, SC): State.COMPLETING,
    (State.COMPLETING, SC): State.COMPLETE,
    (State.COMPLETE, Command.RESET): State.RESETTING,
    (State.HOLDING, SC): State.HELD,
    (State.HELD, Command.UNHOLD): State.UNHOLDING,
    (State.UNHOLDING, SC): State.EXECUTE,
    (State.EXECUTE, Command.SUSPEND): State.SUSPENDING,
    (State.SUSPENDING, SC): State.SUSPENDED,
    (State.SUSPENDED, Command.UNSUSPEND): State.UNSUSPENDING,
    (State.UNSUSPENDING, SC): State.EXECUTE,
    (State.STOPPING, SC): State.STOPPED,
    (State.ABORTING, SC): State.ABORTED,
    **{(state, Command.HOLD): State.HOLDING for state in State if state in HOLDABLE},
    **{(state, Command.COMPLETE): State.COMPLETING for state in State if state in COMPLETABLE},
    **{(state, Command.STOP): State.STOPPING for state in State if state not in NOT_STOPPABLE},
    **{(state, Command.ABORT): State.ABORTING for state in State if state not in NOT_ABORTABLE},
}

ACTING = frozenset(state for state, event in TRANSITIONS if event is SC)
"""The states in which the cell works; they end by SC or are cut short by a command. In the others it waits."""


class NotAllowed(Exception):
    """This command or mode means nothing in this state; the text says what is allowed now."""


def after(state: State, event: Event) -> State:
    """The state that follows, or NotAllowed."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise NotAllowed(f"{event.title} is not possible in {state.title}; {_allowed_sentence(state)}") from None


def commands_allowed(state: State) -> tuple[Command, ...]:
    """What may be asked for in this state, by number."""
    return tuple(command for command in Command if (state, command) in TRANSITIONS)


def mode_after(state: State, now: Mode, wanted: Mode) -> Mode:
    """The mode that follows, or NotAllowed: the cell changes its mode only while it is at rest."""
    if wanted is now or state in MODE_CHANGES:
        return wanted
    rest = ", ".join(sorted(allowed.title for allowed in MODE_CHANGES))
    raise NotAllowed(f"the mode cannot change from {now.title} to {wanted.title} in {state.title}; it can in {rest}")


def _allowed_sentence(state: State) -> str:
    commands = ", ".join(command.title for command in commands_allowed(state))
    if not commands:
        return f"nothing is allowed now, wait until {state.title} has ended"
    return f"allowed now: {commands}"


MANY = 3
"""An event that leaves more states than this is drawn from one box that lists them."""


def diagram() -> str:
    """The table as a Mermaid state diagram, for README.md."""
    sources: dict[tuple[Event, State], list[State]] = {}
    for (state, event), following in TRANSITIONS.items():
        sources.setdefault((event, following), []).append(state)
    rows = [row for (event, following), states in sources.items() for row in _rows(event, following, states)]
    return "\n".join(["stateDiagram-v2", "    [*] --> Aborted", *rows])


def _rows(event: Event, following: State, states: list[State]) -> list[str]:
    if len(states) <= MANY:
        return [f"    {state.title} --> {following.title}: {event.title}" for state in states]
    box = f"may_{event.title}"
    listed = ", ".join(state.title for state in states)
    return [f'    state "{listed}" as {box}', f"    {box} --> {following.title}: {event.title}"]
