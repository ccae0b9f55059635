"""Reading pictures from files: what is read, what is said about it, and what is refused by name."""

import contextlib
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from cellctl.pictures.files import PictureError, picture_paths, read_picture, write_picture

RNG = np.random.default_rng(3)
MONO = RNG.integers(0, 256, (80, 120), dtype=np.uint8)
COLOUR = RNG.integers(0, 256, (80, 120, 3), dtype=np.uint8)
DEEP = RNG.integers(0, 65536, (80, 120), dtype=np.uint16)


def encoded(suffix: str, pixels: np.ndarray) -> bytes:
    ok, content = cv2.imencode(suffix, pixels)
    assert ok
    return content.tobytes()


def saved(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_a_mono_picture_comes_back_pixel_by_pixel_and_without_a_word(suffix: str, tmp_path: Path) -> None:
    picture = read_picture(saved(tmp_path, f"a{suffix}", encoded(suffix, MONO)))
    assert np.array_equal(picture.pixels, MONO)
    assert picture.notes == ()


def test_a_jpeg_is_nearly_the_same_and_says_that_it_loses_detail(tmp_path: Path) -> None:
    smooth = cv2.GaussianBlur(MONO, (0, 0), 4.0)
    picture = read_picture(saved(tmp_path, "a.jpg", encoded(".jpg", smooth)))
    assert np.abs(picture.pixels.astype(int) - smooth).max() < 10
    assert "JPEG" in picture.notes[0]


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_a_deep_picture_keeps_its_upper_eight_bits(suffix: str, bits: int, tmp_path: Path) -> None:
    deep = DEEP >> (16 - bits)
    picture = read_picture(saved(tmp_path, f"a{suffix}", encoded(suffix, deep)), bits)
    assert np.abs(picture.pixels - deep / 2 ** (bits - 8)).max() <= 1.0
    assert picture.notes == (f"{bits} bit, divided by {2 ** (bits - 8)}",)


def test_a_camera_with_twelve_bits_in_sixteen_is_not_taken_for_a_dark_picture(tmp_path: Path) -> None:
    path = saved(tmp_path, "a.png", encoded(".png", DEEP >> 4))
    with pytest.raises(PictureError, match=r"a\.png: has 16 bit but no value above 40\d\d: .*--bits 12"):
        read_picture(path)
    with pytest.raises(PictureError, match="more than 10 bit"):
        read_picture(path, 10)


def test_colour_is_converted_with_a_word_and_grey_saved_as_colour_is_not(tmp_path: Path) -> None:
    picture = read_picture(saved(tmp_path, "a.png", encoded(".png", COLOUR)))
    assert picture.notes == ("colour, converted to grey",)
    assert np.array_equal(picture.pixels, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY))
    same = read_picture(saved(tmp_path, "b.png", encoded(".png", cv2.merge([MONO] * 3))))
    assert np.array_equal(same.pixels, MONO)
    assert same.notes == ()


def test_a_transparent_picture_is_refused_and_an_opaque_one_read(tmp_path: Path) -> None:
    opaque, through = (cv2.merge([MONO] * 3 + [np.full_like(MONO, alpha)]) for alpha in (255, 100))
    assert np.array_equal(read_picture(saved(tmp_path, "a.png", encoded(".png", opaque))).pixels, MONO)
    with pytest.raises(PictureError, match="transparent"):
        read_picture(saved(tmp_path, "b.png", encoded(".png", through)))


def test_a_file_of_several_pages_says_that_the_first_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "pages.tif"
    cv2.imwritemulti(str(path), [MONO, np.zeros_like(MONO)])
    picture = read_picture(path)
    assert np.array_equal(picture.pixels, MONO)
    assert picture.notes == ("first of several pages",)


def test_a_picture_of_floats_and_a_small_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="type float32"):
        read_picture(saved(tmp_path, "a.tif", encoded(".tif", MONO.astype(np.float32))))
    with pytest.raises(PictureError, match=r"is 120 x 40 px; at least 64 x 64"):
        read_picture(saved(tmp_path, "b.png", encoded(".png", MONO[:40])))


def test_a_picture_that_claims_to_be_huge_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    content = bytearray(encoded(".png", MONO))
    content[16:24] = struct.pack(">II", 60_000, 60_000)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    with pytest.raises(PictureError, match=r"claims 60000 x 60000 px"):
        read_picture(saved(tmp_path, "bomb.png", bytes(content)))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".jpg"])
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.99))
def test_a_file_that_is_cut_off_is_refused_with_its_name(suffix: str, share: float, tmp_path: Path) -> None:
    whole = encoded(suffix, MONO)
    path = saved(tmp_path, f"cut{suffix}", whole[: int(len(whole) * share)])
    with pytest.raises(PictureError, match=rf"cut\{suffix}: (is|has) "):
        read_picture(path)


def flipped(content: bytes, at: float, with_: int) -> bytes:
    place = int(at * len(content))
    return content[:place] + bytes([content[place] ^ with_]) + content[place + 1 :]


@pytest.mark.parametrize("make", [lambda s=s: encoded(s, MONO) for s in (".png", ".tif", ".bmp", ".jpg")])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.floats(0.0, 0.999), with_=st.integers(1, 255))
def test_a_damaged_file_is_read_or_refused_and_never_ends_the_program(
    make: Callable[[], bytes], at: float, with_: int, tmp_path: Path
) -> None:
    path = saved(tmp_path, "damaged", flipped(make(), at, with_))
    with contextlib.suppress(PictureError):
        picture = read_picture(path)
        assert picture.pixels.dtype == np.uint8
        assert min(picture.pixels.shape) >= 64


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    head=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08", b"BM", b"\xff\xd8\xff"]),
    rest=st.binary(max_size=300),
)
@example(head=b"", rest=b"")
def test_any_other_bytes_are_refused_with_the_files_name(head: bytes, rest: bytes, tmp_path: Path) -> None:
    path = saved(tmp_path, "some.dat", head + rest)
    with pytest.raises(PictureError, match=r"some\.dat: "):
        read_picture(path)


def test_a_folder_gives_its_pictures_in_the_order_that_people_count(tmp_path: Path) -> None:
    for name in ("p10.png", "p9.TIF", "p1.jpeg", "notes.txt", ".hidden.png"):
        (tmp_path / name).touch()
    (tmp_path / "empty").mkdir()
    assert [path.name for path in picture_paths([tmp_path])] == ["p1.jpeg", "p9.TIF", "p10.png"]
    assert len(picture_paths([tmp_path, tmp_path / "p10.png"])) == 3
    with pytest.raises(PictureError, match="there is no picture in it"):
        picture_paths([tmp_path / "empty"])
    with pytest.raises(PictureError, match="there is no such file or folder"):
        picture_paths([tmp_path / "p11.png"])


def test_a_folder_instead_of_a_file_and_a_place_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    with pytest.raises(PictureError, match="cannot be read"):
        read_picture(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(PictureError, match=r"file/drawn\.jpg: cannot be written"):
        write_picture(tmp_path / "file" / "drawn.jpg", cv2.merge([MONO] * 3))
