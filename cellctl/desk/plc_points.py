"""The contract with the PLC, point by point, as far as nothing moves.

First what can be read beside a running daemon, then what needs a session of our own. A PLC that serves somebody else is
only read.
"""

import asyncio
import secrets
import time

from cellctl.desk.plc_player import COMMAND, HEARTBEAT, OUTPUTS, SEQUENCE, SESSION, Found, Picture, Player, Point, came
from drivers.errors import DeviceError
from drivers.plc_registers import MAP_VERSION, Command, PlcState

UNKNOWN_COMMAND = 99
SERVED_WITHIN_S = 0.3
SAFE, ENABLE = 0b0011, 0b1000  # of register 104: emergency stop circuit and guard; robot enable
USED_BITS = {104: 0x000F, 105: 0x00FF, 106: 0x000F, 119: 0x00FF} | dict.fromkeys(range(120, 132), 0)
SILENT_S, FREED_S = (0.4, 0.9), (0.9, 1.5)  # what the contract's 500 ms and 1 s may become with cycle and network
OK, UNKNOWN, NOT_YOUR_SESSION = 0, 2, 5


# -- reading -----------------------------------------------------------------------------------------------------


async def map_version(player: Player) -> Found:
    """Register 101, which also shows turned bytes and an address that is one off."""
    picture = await player.look()
    version = picture[101]
    remedy = "load the PLC program of this cellctl"
    if version == MAP_VERSION >> 8:
        remedy = "the bytes are turned: change byte_order in [plc]"
    elif MAP_VERSION in (picture[100], picture[102]):
        off = "less" if picture[100] == MAP_VERSION else "more"
        remedy = f"the registers lie one off: make plc_registers_at in [plc] one {off}"
    return Found(version == MAP_VERSION, came(picture, 101), remedy)


async def cell_words(player: Player) -> Found:
    """Registers 0..15 can be read back; what stands there is kept for the vacuum's sake."""
    words = await player.probe.cell_words()
    player.words[OUTPUTS] = words[OUTPUTS] & 1  # a battery may hang at the cup
    return Found(True, f"{len(words)} registers, 1 session = {words[SESSION]:#06x}")


async def heartbeat_runs(player: Player) -> Found:
    """Register 100."""
    first = await player.look()
    seen = await player.stay_silent(lambda now: now[100] != first[100], 0.5)
    text = f"{first[100]}, then {seen.picture[100]} after {seen.after_s * 1000:.0f} ms"
    return Found(seen.held, f"100 PLC heartbeat = {text}", "put the PLC into RUN; count register 100 up in every cycle")


async def state_is_known(player: Player) -> Found:
    """Register 103."""
    picture = await player.look()
    return Found(picture[103] <= max(PlcState), came(picture, 103), f"register 103 may be 0..{max(PlcState):d}")


async def reserved_is_zero(player: Player) -> Found:
    """Bits and registers that the contract reserves."""
    picture = await player.look()
    wrong = [f"{at} = {picture[at]:#06x}" for at, used in USED_BITS.items() if picture[at] & ~used]
    return Found(not wrong, ", ".join(wrong) or "all zero", "write 0 into what is reserved; are words or bits shifted?")


async def cycle_is_fast(player: Player) -> Found:
    """Register 116: slower than 100 ms and the PLC cannot see every exchange."""
    seen = await player.stay_silent(lambda now: 0 < now[116] <= 1000, 0.5)
    return Found(seen.held, came(seen.picture, 116), "show the cycle time in 0.1 ms, and stay below 100 ms")


async def arrival_age_counts(player: Player) -> Found:
    """Registers 111 and 112 count milliseconds, high word first; tried when a base has come since the PLC's start."""
    first, began_s = await player.look(), time.monotonic()
    if first[110] == 0:
        return Found(None, came(first, 110, 111), "no base has come yet; --move lets one come")
    await asyncio.sleep(0.4)
    last, took_ms = await player.look(), (time.monotonic() - began_s) * 1000
    grew_ms = _age_ms(last) - _age_ms(first)
    text = f"{came(last, 111)}, {grew_ms} ms more after {took_ms:.0f} ms"
    turned = grew_ms >= 0x10000 - 1
    remedy = "the words are turned: change word_order in [plc]" if turned else "count milliseconds since the arrival"
    return Found(0.7 * took_ms <= grew_ms <= 1.3 * took_ms + 50, text, remedy)


def _age_ms(picture: Picture) -> int:
    return picture[111] << 16 | picture[112]


# -- a session of our own ------------------------------------------------------------------------------------------


async def nobody_is_served(player: Player) -> Found:
    """Register 102; else everything that follows would disturb somebody's work."""
    picture = await player.look()
    remedy = "end the other client (systemctl stop cellctl), wait 1 s and check again"
    return Found(True if picture[102] == 0 else None, came(picture, 102), remedy)


async def exchange_works(player: Player) -> Found:
    """The configured function codes; the first words of a session that is not served yet."""
    picture = await player.look()
    player.words.update({SESSION: _other(player), HEARTBEAT: 0, SEQUENCE: picture[107], COMMAND: 0})
    try:
        await player.beat()
    except DeviceError as error:
        return Found(False, error.detail, "", player.sent(HEARTBEAT, SESSION, SEQUENCE))
    return Found(True, "words written and picture read", "", player.sent(HEARTBEAT, SESSION, SEQUENCE))


async def words_are_kept(player: Player) -> Found:
    """What was written is what stands there."""
    kept = list(await player.probe.cell_words())
    wrong = [f"{at} = {kept[at]}" for at, word in player.words.items() if kept[at] != word]
    return Found(not wrong, ", ".join(wrong) or "read back the same", "keep registers 0..15 as they are written")


async def session_is_served(player: Player) -> Found:
    """Register 102, as soon as the PLC has seen a heartbeat."""
    seen = await player.play(lambda now: now[102] == player.words[SESSION], SERVED_WITHIN_S)
    return _found(player, seen.held, seen.picture, (SESSION,), (102,), "serve the first live session that is not 0")


async def state_follows_client(player: Player) -> Found:
    """A living client ends "client silent"; ready, unless a fault or the emergency stop says otherwise."""
    wrong = (PlcState.STARTING, PlcState.CLIENT_SILENT)
    seen = await player.play(lambda now: now[103] not in wrong, 0.5)
    return _found(player, seen.held, seen.picture, (HEARTBEAT,), (103, 104), "show ready when a client lives")


async def enable_follows_client(player: Player) -> Found:
    """With the safety circuit closed, a living client gives the robot enable."""
    seen = await player.play(lambda now: bool(now[104] & ENABLE), 0.5)
    if seen.picture[104] & SAFE != SAFE:
        return Found(None, came(seen.picture, 104), "close emergency stop circuit and guard, and check again")
    return _found(player, seen.held, seen.picture, (HEARTBEAT,), (104,), "enable the robot while the heartbeat moves")


async def unknown_command_is_refused(player: Player) -> Found:
    """Result 2."""
    seen = await player.command(UNKNOWN_COMMAND)
    passed = seen.held and seen.picture[109] == UNKNOWN
    return _found(player, passed, seen.picture, (SEQUENCE, COMMAND), (107, 108, 109), "answer it with result 2")


async def same_number_is_not_executed(player: Player) -> Found:
    """The number decides, whatever the command is: exactly once."""
    player.words[COMMAND] = Command.STOP_CONVEYOR
    seen = await player.play(lambda now: now[109] != UNKNOWN, 0.2)
    remedy = "execute a command only when its number differs from the last one"
    return _found(player, not seen.held, seen.picture, (SEQUENCE, COMMAND), (107, 108, 109), remedy)


async def new_number_is_executed(player: Player) -> Found:
    """Stop conveyor, which moves nothing."""
    seen = await player.command(Command.STOP_CONVEYOR)
    passed = seen.held and seen.picture[109] == OK
    return _found(player, passed, seen.picture, (SEQUENCE, COMMAND), (107, 108, 109), "answer it with result 0")


async def lower_number_is_new(player: Player) -> Found:
    """Numbers are told apart, not compared: a client that starts anew may count from anywhere."""
    player.words[SEQUENCE] = (player.words[SEQUENCE] - 100) % 0xFFFF + 1
    seen = await player.command(UNKNOWN_COMMAND)
    passed = seen.held and seen.picture[109] == UNKNOWN
    return _found(player, passed, seen.picture, (SEQUENCE, COMMAND), (107, 108, 109), "any other number is a new one")


async def second_client_is_refused(player: Player) -> Found:
    """Words of another session are not obeyed: result 5, and ours stays served."""
    ours, before = player.words[SESSION], dict(player.words)
    player.words[SESSION] = _other(player)
    seen = await player.command(UNKNOWN_COMMAND, within_s=0.3)
    found = _found(
        player,
        seen.held and seen.picture[109] == NOT_YOUR_SESSION and seen.picture[102] == ours,
        seen.picture,
        (SESSION, SEQUENCE, COMMAND),
        (102, 107, 108, 109),
        "serve one session; answer another one's command with its number and result 5",
    )
    player.words.update(before)
    await player.beat()
    return found


async def silence_drops_enable(player: Player) -> Found:
    """A heartbeat that stands still for 500 ms."""
    before = await player.beat()
    if not before[104] & ENABLE:
        return Found(None, came(before, 104), "robot enable was off before; make the cell safe and check again")
    seen = await player.stay_silent(lambda now: not now[104] & ENABLE, 1.0)
    passed = seen.held and SILENT_S[0] <= seen.after_s <= SILENT_S[1] and bool(seen.picture[106] & ENABLE)
    text = f"{came(seen.picture, 103, 104, 106)}, {seen.after_s * 1000:.0f} ms after the last exchange"
    return Found(passed, text, "drop the enable 500 ms after register 0 last changed, and latch that in 106")


async def silence_frees_session(player: Player) -> Found:
    """A session that is silent for 1 s is served no more; counted from an exchange of this point."""
    await player.play(lambda now: now[102] == player.words[SESSION], SERVED_WITHIN_S)
    seen = await player.stay_silent(lambda now: now[102] == 0, 2.0)
    passed = seen.held and FREED_S[0] <= seen.after_s <= FREED_S[1]
    text = f"{came(seen.picture, 102)}, {seen.after_s * 1000:.0f} ms after the last exchange"
    return Found(passed, text, "show 0 in 102 when register 0 stood still for 1 s")


async def standing_command_is_refused(player: Player) -> Found:
    """What stood there when a session begins was not given to this PLC: result 5, and it is not executed."""
    player.words[SESSION] = _other(player)
    seen = await player.command(UNKNOWN_COMMAND, within_s=0.5)
    passed = seen.held and seen.picture[109] == NOT_YOUR_SESSION
    remedy = "when a session begins take the number that stands in 3 as done, with result 5"
    return _found(player, passed, seen.picture, (SESSION, SEQUENCE, COMMAND), (107, 108, 109), remedy)


async def latches_are_reset(player: Player) -> Found:
    """Command 5 clears what is healthy again."""
    await player.play(lambda now: bool(now[104] & ENABLE), 0.5)
    seen = await player.command(Command.RESET_LATCHES)
    passed = seen.held and seen.picture[109] == OK and not seen.picture[106] & seen.picture[104]
    return _found(player, passed, seen.picture, (SEQUENCE, COMMAND), (104, 106, 109), "clear 106 with command 5")


def _other(player: Player) -> int:
    """A session number that is neither 0 nor ours."""
    while (number := secrets.randbelow(0xFFFF) + 1) == player.words[SESSION]:
        pass
    return number


def _found(
    player: Player, passed: bool, picture: Picture, sent: tuple[int, ...], seen: tuple[int, ...], remedy: str
) -> Found:
    return Found(passed, came(picture, *seen), remedy, player.sent(*sent))


READING = (
    Point("the map version is 0x0100", map_version),
    Point("registers 0..15 can be read", cell_words),
    Point("the PLC's heartbeat runs", heartbeat_runs),
    Point("the PLC's state is one of the contract", state_is_known),
    Point("what is reserved is 0", reserved_is_zero),
    Point("the PLC's cycle is shown and fast enough", cycle_is_fast),
)
ARRIVED = Point("the time since an arrival counts milliseconds", arrival_age_counts)
OWNING = Point("no other client is served", nobody_is_served)
SERVED = (
    Point("words are written and the picture is read as configured", exchange_works),
    Point("written words are kept", words_are_kept),
    Point("a live session is served", session_is_served),
    Point("the PLC's state follows its client", state_follows_client),
    Point("a living client gives the robot enable", enable_follows_client),
    Point("an unknown command is refused", unknown_command_is_refused),
    Point("a command with the same number is not executed", same_number_is_not_executed),
    Point("a command with a new number is executed", new_number_is_executed),
    Point("a lower number is a new one", lower_number_is_new),
    Point("a second client is refused", second_client_is_refused),
    Point("500 ms of silence drop the robot enable", silence_drops_enable),
    Point("1 s of silence frees the session", silence_frees_session),
    Point("a command that stood there before the session is refused", standing_command_is_refused),
    Point("the latches are reset by command", latches_are_reset),
)
