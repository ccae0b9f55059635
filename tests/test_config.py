"""cell.toml: what an integrator writes, what is refused, and that the shipped ones load."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.arm import build_robot, limits_of
from cellctl.config import CellConfig, load_config
from cellctl.strict_toml import SettingsError
from drivers.plc_layout import Layout

DEPLOY = Path(__file__).parent.parent / "deploy"
CELL, SIMULATED = DEPLOY / "cell.toml", DEPLOY / "simulated-cell.toml"


@pytest.fixture
def config(tmp_path: Path) -> Callable[..., CellConfig]:
    """cell.toml with pieces of text replaced."""

    def config(*replacements: tuple[str, str]) -> CellConfig:
        text = CELL.read_text()
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "cell.toml").write_text(text)
        return load_config(tmp_path / "cell.toml")

    return config


@pytest.fixture
def refused(config: Callable[..., CellConfig]) -> Callable[..., list[str]]:
    def refused(*replacements: tuple[str, str]) -> list[str]:
        with pytest.raises(SettingsError) as caught:
            config(*replacements)
        return [re.sub(r"^.*?\.toml:\d+:\d+: ", "", line) for line in caught.value.lines]

    return refused


def keys(table: dict, above: str = "") -> set[str]:
    below = [keys(value, f"{above}{key}.") for key, value in table.items() if isinstance(value, dict)]
    return {f"{above}{key}" for key in table}.union(*below)


def test_the_cell_of_the_repository_loads():
    cell = load_config(CELL)
    assert cell.positions.station.x_mm == 282
    assert cell.robot.reaches(282, 120)
    assert cell.addresses == ["192.168.10.10", "192.168.10.31", "192.168.10.32", "192.168.10.20"]


def test_the_simulated_cell_loads_and_stays_inside_the_checkout_and_on_loopback():
    cell = load_config(SIMULATED)
    assert all(address.startswith("127.") for address in cell.addresses)
    assert cell.paths.recipes == DEPLOY.parent / "recipes"
    for path in (cell.paths.state, cell.paths.control_socket, cell.paths.log):
        assert path.is_relative_to(DEPLOY.parent / "build" / "simulated-cell")
    assert (cell.camera_1.serial, cell.camera_2.serial) == ("SIM-CAM-1", "SIM-CAM-2")


def test_the_simulated_cell_differs_from_the_cell_only_in_how_it_is_reached():
    real, simulated = (tomllib.loads(path.read_text()) for path in (CELL, SIMULATED))
    assert keys(real) == keys(simulated)
    for table, key in re.findall(
        r"(\w+)\.(\w+)",
        "plc.host plc.port plc.scan_period_ms plc.stale_after_ms robot.address robot.serial"
        " camera_1.address camera_1.serial camera_2.address camera_2.serial",
    ):
        del real[table][key], simulated[table][key]
    for cell in (real, simulated):
        del cell["paths"], cell["name"]
    assert real == simulated


def test_how_a_plc_offers_its_registers_reaches_the_driver(config):
    replaced = (
        ('exchange = "fc23"', 'exchange = "fc4+fc16"'),
        ("cell_registers_at = 0", "cell_registers_at = 12"),
        ("plc_registers_at = 100", "plc_registers_at = 0"),
        ('byte_order = "high_first"', 'byte_order = "low_first"'),
        ('word_order = "high_first"', 'word_order = "low_first"'),
    )
    address = config(*replaced).plc.address
    assert address.exchange == "fc4+fc16"
    assert address.layout == Layout(12, 0, low_byte_first=True, low_word_first=True)
    assert config().plc.address.layout == Layout()


def test_relative_paths_count_from_the_folder_of_the_file(config, tmp_path):
    cell = config(('"/var/log/cellctl"', '"logs/../log"'))
    assert cell.paths.log == tmp_path / "log"
    assert cell.paths.state == Path("/var/lib/cellctl")


def test_a_socket_path_that_the_kernel_would_refuse_is_refused(refused):
    (line,) = refused(('"/run/cellctl/control.sock"', f'"/run/{"x" * 110}/control.sock"'))
    assert line.startswith("paths.control_socket: the path of a socket may have 107 bytes at most")


def test_a_robot_on_a_serial_line_has_no_address(config):
    cell = config(('"tcp://192.168.10.20:23" ', '"serial:/dev/robot?baud=38400&parity=even&flow=none" '))
    assert cell.addresses == ["192.168.10.10", "192.168.10.31", "192.168.10.32"]


@pytest.mark.parametrize(
    "address",
    [
        "192.168.10.20:23",
        "tcp://192.168.10.20",
        "tcp://192.168.10.20:0",
        "tcp://192.168.10.20:70000",
        "tcp://192.168.10.20:23/path",
        "tcp://robot:23",
        "tcp://[::1]:23",
        "tcp://[",
        "serial:ttyS0",
        "serial:/dev/ttyS0?baud=9601",
        "serial:/dev/ttyS0?bits=7",
        "",
    ],
)
def test_an_address_that_no_robot_can_have_is_refused(refused, address):
    (line,) = refused(('"tcp://192.168.10.20:23" ', f'"{address}" '))
    assert line.startswith("robot.address: ")


@pytest.mark.parametrize(
    "host", ["plc", "192.168.10", "192.168.10.256", "0.0.0.0", "224.0.0.1", "255.255.255.255", "::1"]
)
def test_a_host_that_no_device_can_have_is_refused(refused, host):
    (line,) = refused(("192.168.10.10", host))
    assert line.startswith("plc.host: must be ")


@pytest.mark.parametrize(
    ("replacements", "lines"),
    [
        ([("port = 502", "port = 70000")], ["plc.port: must be at least 1 and at most 65535 (got 70000)"]),
        (
            [('exchange = "fc23"', 'exchange = "fc16"')],
            ['plc.exchange: must be "fc23", "fc3+fc16" or "fc4+fc16" (got "fc16")'],
        ),
        (
            [("plc_registers_at = 100", "plc_registers_at = 10")],
            ["plc.plc_registers_at: cellctl's registers 0..15 overlap the PLC's 10..41 on the wire"],
        ),
        (
            [("cell_registers_at = 0", "cell_registers_at = 65530")],
            ["plc.plc_registers_at: cellctl's registers 65530..65545 are not all in 0..65535"],
        ),
        ([('byte_order = "high_first"', 'byte_order = "big"')], ["plc.byte_order: must be"]),
        ([("192.168.10.32", "192.168.10.31")], ["camera_2.address: is also the address of camera_1"]),
        ([("CAM-2-SERIAL", "CAM-1-SERIAL")], ["camera_2.serial: is also the serial of camera_1"]),
        (
            [('"CAM-2-SERIAL"', '""')],
            ["camera_2.serial: must be the serial number on the label: up to 16 of A-Z a-z 0-9 . _ -"],
        ),
        ([('mount = "tool"', 'mount = "bench"')], ['camera_1.mount: must be "tool" or "arm_2" (got "bench")']),
        (
            [('mount = "tool"', 'mount = "arm_2"'), ("board = { x_mm = 340", "board = { x_mm = 480")],
            [
                "positions.board: camera 1 on the second arm comes 5.0 to 455.0 mm far from the first axis, "
                "(480.0, -20.0) is 480.4 mm away"
            ],
        ),
        (
            [('mount = "tool"', 'mount = "arm_2"'), ("camera_1_z_mm = 60", "camera_1_z_mm = 61")],
            ["positions.camera_1_z_mm: camera 1 on the second arm needs no own Z: use safe_z_mm = 60"],
        ),
        (
            [
                (
                    "repeatability_deg = 0.004",
                    'keep_out = [{ name = "post", x_min_mm = 9, x_max_mm = 8, y_min_mm = 0, y_max_mm = 1 }]\n'
                    "repeatability_deg = 0.004",
                )
            ],
            ["robot.keep_out.0.x_min_mm: must be below x_max_mm = 8"],
        ),
        (
            [("mm_per_px = 0.007333", "mm_per_px = 7.333")],
            ["camera_1.mm_per_px: must be at least 0.0005 and at most 0.2 mm per px (got 7.333)"],
        ),
        (
            [("reach_outer_mm = 398", "reach_outer_mm = 401")],
            ["robot.reach_outer_mm: both arms together are only 400 mm long"],
        ),
        ([("reach_inner_mm = 135", "reach_inner_mm = 49")], ["robot.reach_inner_mm: folded arms still reach 50 mm"]),
        (
            [("z_min_mm = 0", "z_min_mm = 5"), ("z_max_mm = 150", "z_max_mm = 3")],
            ["robot.z_min_mm: must be below z_max_mm = 3"],
        ),
        (
            [("z_max_mm = 150", "z_max_mm = 104")],
            ["positions.nest_z_mm: the robot's Z goes from 0 to 104 mm"],
        ),
        (
            [("camera_2_z_mm = 60", "camera_2_z_mm = 10")],
            ["positions.camera_2_z_mm: lies above safe_z_mm = 60 (Z is positive down)"],
        ),
        (
            [("reject = { x_mm = 100", "reject = { x_mm = 350")],
            ["positions.reject: the tool would be 436.0 mm from the first axis, the robot reaches 135 to 398 mm"],
        ),
        (
            [("station = { x_mm = 282, y_mm = 120", "station = { x_mm = 150, y_mm = 50")],
            ["positions.station: the tool would be 107.4 mm from the first axis, the robot reaches 135 to 398 mm"],
        ),
        (
            [("origin_dot_mm = 0.9", "origin_dot_mm = 0.6")],
            ["board.origin_dot_mm: must be at least 1.2 x dot_mm = 0.72 to be told apart"],
        ),
        ([("pitch_mm = 1.2", "pitch_mm = 0.7")], ["board.pitch_mm: the large dot and its neighbour touch"]),
        (
            [("rows = 7", "rows = 13")],
            [f"board.rows: the board is 15.3 mm long, camera_{camera} sees 14.26 mm" for camera in (1, 2)],
        ),
        (
            [("progress_within_s = 1.0", "progress_within_s = 2.0")],
            ["watchdog.progress_within_s: must be at least 0.1 and at most 1.5 s"],
        ),
        (
            [("safe_z_mm = 60", "safe_z_um = 60")],
            ["positions.safe_z_mm: is missing", "positions.safe_z_um: is not known here; did you mean safe_z_mm?"],
        ),
    ],
)
def test_a_cell_that_cannot_be_is_refused_at_the_right_key(refused, replacements, lines):
    said = refused(*replacements)
    assert len(said) == len(lines)
    for one, beginning in zip(said, lines, strict=True):
        assert one.startswith(beginning)


def test_a_mistake_is_shown_with_its_line_and_column(config, tmp_path):
    row = next(row for row, line in enumerate(CELL.read_text().splitlines(), 1) if line.startswith("station"))
    with pytest.raises(SettingsError) as caught:
        config(("y_mm = 120, t_deg = 0", "y_mm = 12000, t_deg = 0"))
    (line,) = caught.value.lines
    assert line.startswith(f"{tmp_path}/cell.toml:{row}:32: positions.station.y_mm: must be ")


def test_a_missing_table_is_named(config, tmp_path):
    with pytest.raises(SettingsError, match="watchdog: this table is missing"):
        config(("[watchdog]", "[other]"))


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_whatever_values_a_cell_holds_it_is_read_or_refused(tmp_path_factory, data):
    text = CELL.read_text()
    values = list(re.finditer(r"""(?<== )(-?[0-9.]+|"[^"\n]*")""", text))
    for value in sorted(
        data.draw(st.lists(st.sampled_from(values), max_size=4, unique_by=re.Match.start)),
        key=re.Match.start,
        reverse=True,
    ):
        other = data.draw(
            st.one_of(
                st.floats().map(str),
                st.integers().map(str),
                st.text(
                    st.characters(codec="ascii", exclude_categories=["Cc"], exclude_characters="'"), max_size=30
                ).map("'{}'".format),
                st.sampled_from(["'tcp://[::'", "'tcp://1.2.3.4:99999999999'", "'serial:/dev/x?baud='", '"\\u0000"']),
            )
        )
        text = f"{text[: value.start()]}{other}{text[value.end() :]}"
    path = tmp_path_factory.getbasetemp() / "fuzzed-cell.toml"
    path.write_text(text)
    lines: tuple[str, ...] = ()
    try:
        load_config(path)
    except SettingsError as error:
        lines = error.lines
    assert all(re.match(r".*\.toml:\d+:\d+: [a-z_0-9.]+: .", line) for line in lines)


def test_a_robot_of_the_older_generation_with_the_vacuum_valve_on_its_own_output(config):
    more = (
        'hand = "righty"',
        'hand = "righty"\ndialect = "rcx2"\npayload_kg = 1.5\nvacuum_output = 27\n'
        "pulses = { per_deg_or_mm = [2912.7, 2912.7, 1638.4, 682.7], lowest = [-407779, -419430, 0, -245760], "
        "highest = [407779, 419430, 245760, 245760] }",
    )
    robot = config(more).robot
    assert (robot.dialect, robot.payload_kg, robot.vacuum_output) == ("rcx2", 1.5, 27)
    limits = limits_of(robot)
    assert limits.pulses.high.axis_3 == 245760
    assert build_robot(robot).dialect.name == "rcx2"


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ('dialect = "rcx4"', "robot.dialect: "),
        ("payload_kg = -1", "robot.payload_kg: "),
        ("vacuum_output = 17", "robot.vacuum_output: must be an output as the pendant names it"),
        ("vacuum_output = 28", "robot.vacuum_output: must be an output as the pendant names it"),
        ("pulses = { per_deg_or_mm = [1, 1, 1], lowest = [0, 0, 0, 0], highest = [1, 1, 1, 1] }", "robot.pulses."),
        (
            "pulses = { per_deg_or_mm = [1, 1, 1, 1], lowest = [0, 0, 1, 0], highest = [1, 1, 1, 1] }",
            "robot.pulses.lowest: of axis 3 must be below its highest = 1",
        ),
    ],
)
def test_a_setting_that_no_robot_can_have_is_refused(refused, setting, complaint):
    (line,) = refused(('hand = "righty"', f'hand = "righty"\n{setting}'))
    assert line.startswith(complaint)
