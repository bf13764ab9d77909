"""Writing, reading and hashing pictures, and what happens when that fails."""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its documentation uses
import pytest
from joulebox_render.errors import ImageError
from joulebox_render.images import pixel_sha256, read_exr, srgb_bytes, write_exr, write_png


def picture(height: int = 33, width: int = 47) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Values over many orders of magnitude, negative ones included."""
    rng = np.random.default_rng(7)
    return (rng.standard_normal((height, width, 3)) * 10.0 ** rng.uniform(-6, 6, (height, width, 1))).astype(np.float32)


def test_exr_keeps_every_bit(tmp_path: Path) -> None:
    rgb = picture()
    rgb[3, 5] = [np.inf, np.nan, 1e-40]
    write_exr(tmp_path / "a.exr", rgb, {"joulebox:settings": '{"seed": 1}'})
    back = read_exr(tmp_path / "a.exr")
    assert back.dtype == np.float32
    assert back.tobytes() == rgb.tobytes()
    assert pixel_sha256(back) == pixel_sha256(rgb)
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    spec = source.spec()
    source.close()
    assert spec.get_string_attribute("joulebox:settings") == '{"seed": 1}'
    assert spec.get_string_attribute("compression") == "zip"
    assert list(spec.channelnames) == ["R", "G", "B"]
    assert os.listdir(tmp_path) == ["a.exr"]


def test_first_row_is_on_top(tmp_path: Path) -> None:
    """The first scanline stored, which other readers show at the top, is row 0."""
    rgb = np.zeros((4, 2, 3), np.float32)
    rgb[0] = 1.0
    for name, write in (("a.exr", write_exr), ("a.png", lambda path, image: write_png(path, image, 1.0))):
        write(tmp_path / name, rgb)
        source = oiio.ImageInput.open(str(tmp_path / name))
        assert source.read_scanline(0, 0, "float").min() == 1.0
        assert source.read_scanline(3, 0, "float").max() == 0.0
        source.close()


def test_pixel_hash_is_over_little_endian_rows() -> None:
    rgb = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    assert pixel_sha256(rgb) == hashlib.sha256(struct.pack("<12f", *range(12))).hexdigest()
    assert pixel_sha256(rgb[::-1]) != pixel_sha256(rgb)
    assert pixel_sha256(np.asfortranarray(rgb)) == pixel_sha256(rgb)


def test_png_is_srgb(tmp_path: Path) -> None:
    """Known points of the sRGB curve, with exposure, clipping, and NaN shown black."""
    linear = np.array([0.0, 0.0031308, 0.02, 0.2158605, 0.5, 1.0, 7.0, -1.0, np.nan], np.float32)
    rgb = np.repeat(linear[None, :, None], 3, axis=2)
    write_png(tmp_path / "a.png", rgb / 2.0, 2.0)
    source = oiio.ImageInput.open(str(tmp_path / "a.png"))
    stored = source.read_image("uint8")
    source.close()
    assert stored.dtype == np.uint8
    assert stored[0, :, 0].tolist() == [0, 10, 39, 128, 188, 255, 255, 0, 0]
    np.testing.assert_array_equal(stored, srgb_bytes(rgb / 2.0, 2.0))


def test_existing_picture_is_replaced(tmp_path: Path) -> None:
    for value in (1.0, 2.0):
        write_exr(tmp_path / "a.exr", np.full((2, 2, 3), value, np.float32))
    assert read_exr(tmp_path / "a.exr").max() == 2.0


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("a.jpg", ["ends in .exr"]),
        ("a", ["ends in .exr"]),
        ("absent/a.exr", ["no folder", "absent"]),
        ("folder.exr", ["folder"]),
        ("file.exr/a.exr", ["no folder"]),
    ],
)
def test_bad_path(tmp_path: Path, path: str, words: list[str]) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "file.exr").write_text("")
    with pytest.raises(ImageError) as caught:
        write_exr(tmp_path / path, picture())
    assert str(tmp_path / path) in str(caught.value)
    for word in words:
        assert word in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file.exr", "folder.exr"]


def test_bad_shape(tmp_path: Path) -> None:
    for shape in ((4, 4), (4, 4, 4), (0, 4, 3)):
        with pytest.raises(ImageError, match="height, width, 3"):
            write_exr(tmp_path / "a.exr", np.zeros(shape, np.float32))


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder in which nobody can write, as /proc is")
def test_folder_that_cannot_be_written() -> None:
    with pytest.raises(ImageError, match=r"^/proc/a\.exr: cannot be written"):
        write_exr("/proc/a.exr", picture())


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_full_disk_keeps_the_old_picture(tmp_path: Path, name: str) -> None:
    """A limit on file size fails writes half-way, as a full disk does; nothing half-written stays behind."""
    resource = pytest.importorskip("resource", reason="file size limits are POSIX")
    write: Callable[[Path], None] = (
        (lambda path: write_exr(path, picture(200, 200)))
        if name == "a.exr"
        else (lambda path: write_png(path, picture(200, 200), 1.0))
    )
    (tmp_path / name).write_text("old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, hard))
    try:
        with pytest.raises(ImageError, match="cannot be written"):
            write(tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / name).read_text() == "old"
    assert os.listdir(tmp_path) == [name]


def test_what_cannot_be_read(tmp_path: Path) -> None:
    write_exr(tmp_path / "whole.exr", picture())
    data = (tmp_path / "whole.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) // 2])
    (tmp_path / "garbage.exr").write_bytes(b"\x00\xff" * 500)
    write_png(tmp_path / "p.png", picture(), 1.0)
    (tmp_path / "png.exr").write_bytes((tmp_path / "p.png").read_bytes())
    for name, word in (
        ("absent.exr", "no such file"),
        ("cut.exr", "cut off"),
        ("garbage.exr", "not a readable picture"),
        ("p.png", "type png"),
        ("png.exr", "png"),
    ):
        with pytest.raises(ImageError) as caught:
            read_exr(tmp_path / name)
        assert str(caught.value).startswith(str(tmp_path / name))
        assert word in str(caught.value)
        assert "\n" not in str(caught.value)


def test_single_channel_is_refused(tmp_path: Path) -> None:
    output = oiio.ImageOutput.create(str(tmp_path / "z.exr"))
    spec = oiio.ImageSpec(2, 2, 1, "float")
    spec.channelnames = ("Z",)
    assert output.open(str(tmp_path / "z.exr"), spec)
    assert output.write_image(np.zeros((2, 2, 1), np.float32))
    output.close()
    with pytest.raises(ImageError, match="channels Z; R, G and B are needed"):
        read_exr(tmp_path / "z.exr")
