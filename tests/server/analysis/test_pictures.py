"""Reading and writing pictures, and one sentence for every file that is none."""

import io

import numpy as np
import OpenImageIO
import pytest
from joulebox_server.analysis import images
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.images import encode_png, linear_from_srgb, read_picture, srgb_from_linear, tonemap_png
from PIL import Image


@pytest.fixture
def picture():
    return np.random.default_rng(3).uniform(0, 2, (24, 40, 3)).astype(np.float32)


def write_exr(path, values, names=None):
    height, width, channels = values.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, OpenImageIO.FLOAT)
    if names:
        spec.channelnames = names
    out = OpenImageIO.ImageOutput.create(str(path))
    assert out.open(str(path), spec), out.geterror()
    assert out.write_image(np.ascontiguousarray(values, np.float32)), out.geterror()
    out.close()
    return path


def test_exr_and_npy_are_linear_whatever_they_are_called(tmp_path, picture):
    exr = write_exr(tmp_path / "a.exr", picture).rename(tmp_path / ("0" * 64))
    np.testing.assert_array_equal(read_picture(exr), picture)
    np.save(tmp_path / "a.npy", picture.astype(np.float64))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.npy"), picture)


def test_png_is_srgb(tmp_path):
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    (tmp_path / "a.png").write_bytes(encode_png(levels))
    read = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(np.rint(srgb_from_linear(read) * 255), levels)
    assert read[0, 10, 0] == pytest.approx(10 / 255 / 12.92)  # the straight part of the curve
    assert read[11, 12, 0] == pytest.approx(((188 / 255 + 0.055) / 1.055) ** 2.4, rel=1e-5)


def test_srgb_curve_inverts():
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


def test_channels_are_found_by_name(tmp_path, picture):
    opaque = np.concatenate([np.ones((24, 40, 1)), picture[:, :, ::-1]], axis=2)
    path = write_exr(tmp_path / "a.exr", opaque, ["A", "B", "G", "R"])
    np.testing.assert_array_equal(read_picture(path), picture)


def test_wrong_channels(tmp_path, picture):
    one = write_exr(tmp_path / "one.exr", picture[:, :, :1], ["Y"])
    with pytest.raises(AnalysisError, match=r"one.exr has 1 channel \(Y\), it must have R, G and B"):
        read_picture(one)
    clear = np.concatenate([picture, np.full((24, 40, 1), 0.5)], axis=2)
    with pytest.raises(AnalysisError, match="transparent pixels, it must be opaque"):
        read_picture(write_exr(tmp_path / "clear.exr", clear, ["R", "G", "B", "A"]))
    (tmp_path / "grey.png").write_bytes(encode_png(np.zeros((20, 20), np.uint8)))
    with pytest.raises(AnalysisError, match="has 1 channel"):
        read_picture(tmp_path / "grey.png")


@pytest.mark.parametrize("kind", ["exr", "png", "npy"])
def test_truncated_at_any_place(tmp_path, picture, kind, capfd):
    whole = tmp_path / f"whole.{kind}"
    if kind == "exr":
        write_exr(whole, picture)
    elif kind == "png":
        whole.write_bytes(tonemap_png(picture, 1))
    else:
        np.save(whole, picture)
    content = whole.read_bytes()
    for size in {0, 3, 9, 30, 60, 200, 500, len(content) // 2, len(content) - 13, len(content) - 1}:
        cut = tmp_path / f"cut.{kind}"
        cut.write_bytes(content[:size])
        with pytest.raises(AnalysisError, match=r"cut\.\w+ is (a|no) ") as caught:
            read_picture(cut)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # a library's own messages would stand beside the sentence


def test_damaged_pixels(tmp_path, picture):
    content = bytearray(tonemap_png(picture, 1))
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(AnalysisError, match="is a damaged PNG file"):
        read_picture(tmp_path / "a.png")
    content = bytearray(write_exr(tmp_path / "a.exr", np.round(picture)).read_bytes())
    # inside the compressed pixels, behind the header and the table of chunks
    content[-400:-100] = bytes(300)
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(AnalysisError, match="is a damaged or truncated EXR file"):
        read_picture(tmp_path / "a.exr")


def test_files_that_are_no_pictures(tmp_path):
    with pytest.raises(AnalysisError, match=r"missing\.exr does not exist"):
        read_picture(tmp_path / "missing.exr")
    with pytest.raises(AnalysisError, match="cannot be read: "):
        read_picture(tmp_path)
    (tmp_path / "text.exr").write_text("hello")
    with pytest.raises(AnalysisError, match="must be an EXR, PNG or NPY file"):
        read_picture(tmp_path / "text.exr")


def test_arrays_that_are_no_pictures(tmp_path):
    np.save(tmp_path / "whole.npy", np.zeros((20, 20, 3), np.uint8))
    with pytest.raises(AnalysisError, match=r"holds uint8 of shape \(20, 20, 3\), it must hold floats"):
        read_picture(tmp_path / "whole.npy")
    np.save(tmp_path / "pickle.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(AnalysisError, match="damaged or truncated NPY"):
        read_picture(tmp_path / "pickle.npy")


def test_too_many_pixels_are_refused_before_they_are_read(tmp_path, monkeypatch, picture):
    monkeypatch.setattr(images, "MAX_PIXELS", 24 * 40 - 1)
    write_exr(tmp_path / "a.exr", picture)
    np.save(tmp_path / "a.npy", picture)
    for name in ("a.exr", "a.npy"):
        with pytest.raises(AnalysisError, match="is 40 x 24 pixels, it must have at most 16,384 on a side and 959"):
            read_picture(tmp_path / name)


def test_too_many_values_are_refused_before_they_are_decoded(tmp_path, monkeypatch, picture):
    """Channels beside R, G and B: constant ones take next to nothing in the file and all the memory once decoded."""
    wide = np.concatenate([picture, np.zeros((24, 40, 9), np.float32)], axis=2)
    path = write_exr(tmp_path / "a.exr", wide, [*"RGB", *(f"aov{i}" for i in range(9))])
    np.testing.assert_array_equal(read_picture(path), picture)
    monkeypatch.setattr(images, "MAX_VALUES", 24 * 40 * 12 - 1)
    with pytest.raises(AnalysisError, match="has 12 channels of 960 pixels, at most 11,519 values are read"):
        read_picture(path)


def test_tone_map_clips_and_encodes():
    rgb = np.array([[[0.1, 0.5, 9.0], [np.nan, np.inf, -1.0]]], np.float32)
    shown = np.asarray(Image.open(io.BytesIO(tonemap_png(rgb, 2.0))))
    expected = [round(255 * (1.055 * 0.2 ** (1 / 2.4) - 0.055)), 255, 255]
    assert shown.tolist() == [[expected, [0, 0, 0]]]


def test_smaller_pictures_are_averaged_in_linear_light():
    rgb = np.zeros((8, 8, 3), np.float32)
    rgb[:, ::2] = 1
    shown = np.asarray(Image.open(io.BytesIO(tonemap_png(rgb, 1, width=4))))
    assert shown.shape == (4, 4, 3)
    assert (shown == round(255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055))).all()
    assert Image.open(io.BytesIO(tonemap_png(rgb, 1, width=100))).size == (8, 8)
    with pytest.raises(AnalysisError, match="the width is 0 pixels"):
        tonemap_png(rgb, 1, width=0)
