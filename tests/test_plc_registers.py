"""The register map, against an encoding written here a second time from the contract."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.plc_registers import CellWords, Output, PlcState, Safety, decode, why_unsafe

WORD = st.integers(0, 0xFFFF)


def picture(**registers: int) -> list[int]:
    """Registers 100..131 of a healthy, ready PLC, with some replaced: `picture(r106=1)`."""
    words = {100: 7, 101: 0x0100, 102: 0x1234, 103: 1, 104: 0b1111, 117: 3}
    words |= {int(name[1:]): value for name, value in registers.items()}
    return [words.get(address, 0) for address in range(100, 132)]


@given(st.lists(WORD, min_size=32, max_size=32), st.sampled_from(range(6)))
def test_every_field_comes_from_its_own_register(words: list[int], state: int) -> None:
    words[3] = state

    image = decode(words)

    safety = image.estop_healthy | image.guard_closed << 1 | image.air_ok << 2 | image.robot_enable << 3
    inputs = (
        image.photo_switch
        | image.vacuum_reached << 1
        | image.carrier_clamped << 2
        | image.battery_on_table << 3
        | image.conveyor_moving << 4
        | image.start_button << 5
        | image.stop_button << 6
        | image.reset_button << 7
    )
    age_ms = round(image.arrival_age_s * 1000)
    again = [
        image.heartbeat,
        image.map_version,
        image.session,
        int(image.state),
        safety,
        inputs,
        int(image.lost),
        image.accepted,
        image.finished,
        image.result,
        image.arrival_seq,
        age_ms // 65536,
        age_ms % 65536,
        image.carrier_id,
        image.fault,
        round(image.vacuum_kpa * 10) % 65536,
        round(image.cycle_ms * 10),
        image.boot,
        image.stop_presses * 256 + image.start_presses,
        image.reset_presses,
    ]
    used = {4: 0xF, 5: 0xFF, 6: 0xF, 19: 0xFF}
    assert again == [word & used.get(at, 0xFFFF) for at, word in enumerate(words[:20])]


@given(st.lists(WORD, max_size=40) | st.lists(WORD, min_size=32, max_size=32))
def test_any_words_are_decoded_or_refused_with_the_register_named(words: list[int]) -> None:
    if len(words) == 32 and words[3] <= 5:
        assert "\n" not in why_unsafe(decode(words))
    else:
        with pytest.raises(ValueError, match="register"):
            decode(words)


def test_signed_and_long_values_have_the_high_word_first() -> None:
    image = decode(picture(r111=1, r112=2, r115=0x10000 - 655))

    assert image.vacuum_kpa == -65.5
    assert image.arrival_age_s == pytest.approx(65.538)


def test_an_unknown_plc_state_names_register_and_value() -> None:
    with pytest.raises(ValueError, match=r"register 103 \(PLC state\) is 6"):
        decode(picture(r103=6))


@given(st.lists(st.integers(0, 2**40), min_size=10, max_size=10))
def test_words_of_cellctl_stand_at_their_addresses(values: list[int]) -> None:
    words = CellWords(*values).encode()

    assert words == [value % 65536 for value in values] + [0] * 6


def test_words_of_cellctl_have_the_order_of_the_contract() -> None:
    words = CellWords(
        heartbeat=1,
        session=2,
        machine_state=3,
        sequence=4,
        command=5,
        argument=6,
        outputs=Output.VACUUM | Output.BUZZER,
        arrival_acknowledged=8,
        good=9,
        rejected=10,
    ).encode()

    assert words == [1, 2, 3, 4, 5, 6, 0b1000_0001, 8, 9, 10, 0, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("registers", "said"),
    [
        ({"r104": 0b1110}, "emergency stop circuit is open"),
        ({"r104": 0b1101}, "guard is open"),
        ({"r104": 0b1011}, "air pressure is missing"),
        ({"r104": 0b0111}, "robot enable is off"),
        ({"r106": 0b0001}, "emergency stop circuit was lost for a moment"),
        ({"r106": 0b0010}, "guard was lost for a moment"),
        ({"r103": 4, "r114": 12}, "fault 12: see the PLC program"),
        ({"r103": 5}, "emergency stop (register 103)"),
    ],
)
def test_unsafe_says_what_and_where(registers: dict[str, int], said: str) -> None:
    assert said in why_unsafe(decode(picture(**registers)))


def test_a_healthy_picture_is_safe_and_bits_have_their_places() -> None:
    image = decode(picture())

    assert why_unsafe(image) == ""
    assert image.state is PlcState.READY
    assert [int(bit) for bit in Safety] == [1, 2, 4, 8]
    assert [int(bit) for bit in Output] == [1, 2, 4, 8, 16, 32, 64, 128]
