"""The PackML table, against the standard's numbers and against its own picture."""

import re

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cellctl.machine import (
    ACTING,
    SC,
    TRANSITIONS,
    Command,
    Event,
    Mode,
    NotAllowed,
    State,
    after,
    commands_allowed,
    diagram,
    mode_after,
)

EVENTS: list[Event] = [*Command, SC]
STANDARD_NUMBERS = (
    "Clearing 1, Stopped 2, Starting 3, Idle 4, Suspended 5, Execute 6, Stopping 7, Aborting 8, Aborted 9, "
    "Holding 10, Held 11, Unholding 12, Suspending 13, Unsuspending 14, Resetting 15, "
    "Completing 16, Complete 17"
)
STANDARD_COMMANDS = "reset 1, start 2, stop 3, hold 4, unhold 5, suspend 6, unsuspend 7, abort 8, clear 9, complete 10"
# What the standard's drawing shows, written down by hand and on purpose not derived from the table.
DRAWING = """
    Clearing: abort SC>Stopped
    Stopped: abort reset>Resetting
    Resetting: abort stop SC>Idle
    Idle: abort stop start>Starting
    Starting: abort stop hold SC>Execute
    Execute: abort stop hold suspend>Suspending complete SC>Completing
    Completing: abort stop SC>Complete
    Complete: abort stop reset>Resetting
    Holding: abort stop SC>Held
    Held: abort stop complete unhold>Unholding
    Unholding: abort stop hold SC>Execute
    Suspending: abort stop hold SC>Suspended
    Suspended: abort stop hold complete unsuspend>Unsuspending
    Unsuspending: abort stop hold SC>Execute
    Stopping: abort SC>Stopped
    Aborting: SC>Aborted
    Aborted: clear>Clearing
"""
GOES_TO = {"abort": "Aborting", "stop": "Stopping", "hold": "Holding", "complete": "Completing"}


def by_title(title: str) -> State:
    return State[title.upper()]


def drawn() -> dict[tuple[str, str], str]:
    arrows = {}
    for line in DRAWING.strip().splitlines():
        state, events = line.strip().split(": ")
        for item in events.split():
            event, _, following = item.partition(">")
            arrows[state, event] = following or GOES_TO[event]
    return arrows


def test_the_states_and_commands_have_the_numbers_of_the_standard():
    assert ", ".join(f"{state.title} {state.value}" for state in State) == STANDARD_NUMBERS
    assert ", ".join(f"{command.title} {command.value}" for command in Command) == STANDARD_COMMANDS
    assert [(mode.title, mode.value) for mode in Mode] == [
        ("Production", 1),
        ("Maintenance", 2),
        ("Manual", 3),
    ]


def test_the_table_is_the_drawing_of_the_standard():
    table = {(state.title, event.title): following.title for (state, event), following in TRANSITIONS.items()}

    assert table == drawn()


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("event", EVENTS)
def test_every_pair_either_has_its_transition_or_is_refused_with_what_is_allowed(state: State, event: Event):
    if (state.title, event.title) in drawn():
        assert after(state, event) is by_title(drawn()[state.title, event.title])
        return
    with pytest.raises(NotAllowed) as refused:
        after(state, event)
    sentence = str(refused.value)
    assert f"{event.title} is not possible in {state.title}" in sentence
    for command in commands_allowed(state):
        assert command.title in sentence.split("; ")[1]


def test_a_command_number_is_never_taken_for_state_complete():
    assert all(command != SC for command in Command)


def test_only_acting_states_end_by_themselves_and_all_others_wait_for_a_command():
    assert {state.title for state in ACTING} == {
        "Clearing", "Starting", "Execute", "Stopping", "Aborting", "Holding",
        "Unholding", "Suspending", "Unsuspending", "Resetting", "Completing",
    }  # fmt: skip


@pytest.mark.parametrize("state", [state for state in State if state not in (State.ABORTING, State.ABORTED)])
def test_abort_is_allowed_everywhere(state: State):
    assert after(state, Command.ABORT) is State.ABORTING


def test_while_aborting_the_sentence_says_to_wait():
    with pytest.raises(NotAllowed, match="wait until Aborting has ended"):
        after(State.ABORTING, Command.CLEAR)


@pytest.mark.parametrize("state", State)
def test_the_mode_changes_only_at_rest(state: State):
    if state.title in {"Stopped", "Idle", "Aborted"}:
        assert mode_after(state, Mode.PRODUCTION, Mode.MANUAL) is Mode.MANUAL
        return
    with pytest.raises(NotAllowed, match="it can in Aborted, Idle, Stopped"):
        mode_after(state, Mode.PRODUCTION, Mode.MANUAL)


def test_asking_for_the_present_mode_is_no_change():
    assert mode_after(State.EXECUTE, Mode.PRODUCTION, Mode.PRODUCTION) is Mode.PRODUCTION


def test_the_diagram_says_exactly_what_the_table_says():
    lists = {"[*]": ["[*]"]}
    arrows = set()
    for line in diagram().splitlines()[1:]:
        if box := re.fullmatch(r'    state "([A-Za-z, ]+)" as (\w+)', line):
            lists[box[2]] = box[1].split(", ")
            continue
        arrow = re.fullmatch(r"    (\S+) --> (\w+)(?:: (\w+))?", line)
        assert arrow, f"not Mermaid: {line!r}"
        arrows |= {(source, arrow[3], arrow[2]) for source in lists.get(arrow[1], [arrow[1]])}
    table = {(state.title, event.title, after(state, event).title) for state, event in TRANSITIONS}

    assert diagram().startswith("stateDiagram-v2\n")
    assert arrows == table | {("[*]", None, "Aborted")}


class AnyOperator(RuleBasedStateMachine):
    """Somebody presses anything at any time; the work of acting states ends at any time."""

    def __init__(self) -> None:
        super().__init__()
        self.state = State.ABORTED

    @rule(event=st.sampled_from(EVENTS))
    def happens(self, event: Event) -> None:
        before = self.state
        try:
            self.state = after(before, event)
        except NotAllowed:
            assert event not in commands_allowed(before)
            return
        assert self.state is not before

    @rule(command=st.data())
    def asks_for_what_is_offered(self, command: st.DataObject) -> None:
        offered = commands_allowed(self.state)
        if offered:
            self.state = after(self.state, command.draw(st.sampled_from(offered)))

    @invariant()
    def abort_is_at_most_one_command_away(self) -> None:
        if self.state not in (State.ABORTED, State.ABORTING):
            assert after(self.state, Command.ABORT) is State.ABORTING

    @invariant()
    def production_is_reachable_again(self) -> None:
        way_back = {
            State.ABORTED: Command.CLEAR,
            State.STOPPED: Command.RESET,
            State.COMPLETE: Command.RESET,
            State.IDLE: Command.START,
            State.HELD: Command.UNHOLD,
            State.SUSPENDED: Command.UNSUSPEND,
        }
        state = self.state
        for _ in range(10):
            if state is State.EXECUTE:
                return
            state = after(state, way_back.get(state, SC))
        raise AssertionError(f"no way from {self.state.title} to Execute")


TestAnyOperator = AnyOperator.TestCase
TestAnyOperator.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)
