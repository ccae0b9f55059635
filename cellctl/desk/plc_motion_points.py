"""The contract with the PLC, point by point, where the conveyor moves and the vacuum valve switches."""

from cellctl.desk.plc_player import ARGUMENT, COMMAND, OUTPUTS, SEQUENCE, Found, Player, Point, Seen, came
from cellctl.desk.plc_points import ARRIVED
from drivers.plc_registers import Command, Output

NO_CARRIER = 0xFFFF
BRING_WITHIN_S, LEAVE_WITHIN_S, STOP_WITHIN_S, VACUUM_WITHIN_S = 15.0, 10.0, 0.5, 2.0
PHOTO_SWITCH, CLAMPED, MOVING = 0b1, 0b100, 0b10000  # of register 105
OK, WRONG_STATE = 0, 1
VACUUM_CHANGE = 20  # 2 kPa: an open cup sucks little, but a valve that switches shows


async def absent_carrier_stays(player: Player) -> Found:
    """Release names a carrier; one that does not stand there is not released."""
    seen = await player.command(Command.RELEASE_REJECT, NO_CARRIER)
    passed = seen.held and seen.picture[109] == WRONG_STATE and not seen.picture[105] & MOVING
    return _told(player, passed, seen, (105, 107, 108, 109), "compare register 5 with the carrier's id: result 1")


async def base_comes(player: Player) -> Found:
    """Bring: the belt runs, one arrival is counted, the carrier is clamped and has an id."""
    before = await player.beat()
    if before[105] & CLAMPED:
        return Found(None, came(before, 105, 113), "a carrier stands at the station: let it go and check again")
    seen = await player.command(Command.BRING_BASE, within_s=BRING_WITHIN_S)
    now = seen.picture
    counted = (now[110] - before[110]) & 0xFFFF == 1
    stands = now[105] & CLAMPED and now[105] & PHOTO_SWITCH and not now[105] & MOVING
    passed = seen.held and now[109] == OK and counted and bool(stands) and now[113] != 0
    remedy = "count one arrival (110) when the carrier is clamped, show its id (113), then finish with 0; is there one?"
    return _told(player, passed, seen, (105, 109, 110, 113), remedy)


async def second_bring_is_refused(player: Player) -> Found:
    """There is a carrier already."""
    if not (now := await player.beat())[105] & CLAMPED:
        return Found(None, came(now, 105), "no carrier is clamped")
    seen = await player.command(Command.BRING_BASE)
    passed = seen.held and seen.picture[109] == WRONG_STATE
    return _told(player, passed, seen, (105, 109), "answer bring with result 1 while a carrier is clamped")


async def base_goes(player: Player) -> Found:
    """Release of the carrier that stands there; no arrival is counted."""
    before = await player.beat()
    if not before[105] & CLAMPED:
        return Found(None, came(before, 105), "no carrier is clamped")
    seen = await player.command(Command.RELEASE_GOOD, before[113], within_s=LEAVE_WITHIN_S)
    now = seen.picture
    passed = seen.held and now[109] == OK and not now[105] & CLAMPED and now[110] == before[110]
    return _told(player, passed, seen, (105, 109, 110), "open the clamp, let the carrier leave, then finish with 0")


async def stop_ends_bring(player: Player) -> Found:
    """Stop conveyor overtakes: the belt stands, and the stop has result 0."""
    number = player.words[SEQUENCE] % 0xFFFF + 1
    player.words.update({SEQUENCE: number, COMMAND: Command.BRING_BASE, ARGUMENT: 0})
    moving = await player.play(lambda now: bool(now[105] & MOVING), 1.0)
    if not moving.held:
        return _told(player, False, moving, (105, 107, 109), "run the belt when a base is to be brought")
    seen = await player.command(Command.STOP_CONVEYOR)
    stands = await player.play(lambda now: not now[105] & MOVING, STOP_WITHIN_S)
    passed = seen.held and seen.picture[109] == OK and stands.held
    return _told(player, passed, stands, (105, 107, 108, 109), "let command 4 end the one under way")


async def vacuum_switches(player: Player) -> Found:
    """The valve follows bit 0 of register 6: the pressure at the cup falls, and comes back."""
    before = await player.beat()
    if player.words[OUTPUTS] & Output.VACUUM:
        return Found(None, came(before, 115), "the vacuum was on before: a battery may hang at the cup")
    rest = _signed(before[115])
    player.words[OUTPUTS] |= Output.VACUUM
    on = await player.play(lambda now: _signed(now[115]) < rest - VACUUM_CHANGE, VACUUM_WITHIN_S)
    player.words[OUTPUTS] &= ~Output.VACUUM
    off = await player.play(lambda now: _signed(now[115]) > rest - VACUUM_CHANGE, VACUUM_WITHIN_S)
    text = ", ".join(f"{_signed(word) / 10:.1f} kPa" for word in (before[115], on.picture[115], off.picture[115]))
    remedy = "switch the valve by register 6 bit 0, show the pressure in 115"
    return Found(on.held and off.held, f"before, with and after vacuum {text}", remedy, "6 outputs = vacuum, then none")


def _signed(word: int) -> int:
    return word - ((word & 0x8000) << 1)


def _told(player: Player, passed: bool, seen: Seen, shown: tuple[int, ...], remedy: str) -> Found:
    sent = player.sent(SEQUENCE, COMMAND, ARGUMENT)
    return Found(passed, f"{came(seen.picture, *shown)}, after {seen.after_s:.2f} s", remedy, sent)


MOVING_POINTS = (
    Point("a carrier that is not there is not released", absent_carrier_stays),
    Point("stop conveyor ends a bring", stop_ends_bring),
    Point("a base comes, is clamped and counted once", base_comes),
    ARRIVED,
    Point("no second base is brought", second_bring_is_refused),
    Point("the base goes", base_goes),
    Point("the vacuum valve switches", vacuum_switches),
)
