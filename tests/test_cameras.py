"""Which driver a camera of cell.toml gets, and tables that make no sense."""

from pathlib import Path

import pytest

from cellctl.cameras import build_camera
from cellctl.config import load_config
from cellctl.strict_toml import SettingsError
from drivers.file_camera import FileCamera
from drivers.gige import GigeCamera
from drivers.v4l2 import V4l2Camera

CELL = (Path(__file__).parent.parent / "deploy" / "simulated-cell.toml").read_text()
CAMERA_1 = 'driver = "gige"\naddress = "127.0.0.2"'


def load(folder: Path, table: str):
    assert CAMERA_1 in CELL
    path = folder / "cell.toml"
    path.write_text(CELL.replace(CAMERA_1, table))
    return load_config(path)


@pytest.mark.parametrize(
    ("table", "driver"),
    [
        (CAMERA_1, GigeCamera),
        (f'{CAMERA_1}\npixel_format = "Mono12Packed"\npacket_delay_us = 80', GigeCamera),
        ('driver = "v4l2"\naddress = "/dev/video0"', V4l2Camera),
        ('driver = "files"\naddress = "file:pictures"', FileCamera),
    ],
)
def test_each_driver_is_built_by_its_name(tmp_path: Path, table: str, driver: type):
    camera = build_camera("camera 1", load(tmp_path, table).camera_1)
    assert isinstance(camera, driver)
    assert camera.name == "camera 1"


def test_a_folder_counts_from_the_folder_of_the_file(tmp_path: Path):
    cell = load(tmp_path, 'driver = "files"\naddress = "file:../pictures"')
    assert cell.camera_1.folder == tmp_path.parent / "pictures"
    assert cell.addresses == ["127.0.0.1", "127.0.0.3", "127.0.0.1"]


def test_the_place_on_the_sensor_goes_with_the_picture(tmp_path: Path):
    region = load(tmp_path, f"{CAMERA_1}\nview_left_px = 64\nview_top_px = 8").camera_1.region
    assert str(region) == "2592 x 1944 px at 64, 8"


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('driver = "gige"\naddress = "file:x"', "camera_1.address: must be an IPv4 address"),
        ('driver = "gige"\naddress = "0.0.0.0"', "camera_1.address: must be the IPv4 address of one device"),
        ('driver = "files"\naddress = "pictures"', "camera_1.address: must be file:FOLDER"),
        ('driver = "v4l2"\naddress = "video0"', "camera_1.address: must be a device node such as /dev/video0"),
        ('driver = "usb"\naddress = "x"', 'camera_1.driver: must be "gige"'),
        (f'{CAMERA_1}\npixel_format = "mono8"', "camera_1.pixel_format: must be one of Mono8, Mono10"),
        (f'{CAMERA_1}\npixel_format = "MJPG"', "camera_1.pixel_format: MJPG is for the driver v4l2"),
        (f"{CAMERA_1}\ngain_db_per_step = 0.1", "camera_1.gain_db_per_step: is for the driver v4l2"),
        (f"{CAMERA_1}\nview_left_px = -1", "camera_1.view_left_px: must be at least 0"),
        (
            'driver = "files"\naddress = "file:x"\npacket_delay_us = 9',
            "camera_1.packet_delay_us: is for the driver gige",
        ),
    ],
)
def test_a_table_that_makes_no_sense_is_refused_at_its_place(tmp_path: Path, table: str, says: str):
    with pytest.raises(SettingsError) as refused:
        load(tmp_path, table)
    assert any(says in line for line in refused.value.lines), refused.value.lines
