"""Pictures in and out: EXR, PNG and NPY to scene-linear RGB, and scene-linear RGB to PNG.

Pictures are (H, W, 3) float32, first row on top, linear Rec.709. What a file is follows from its first
bytes and not from its name, because pictures in the store are named by their hash.
"""

import io
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray
from PIL import Image

from joulebox_server.analysis.errors import AnalysisError

Picture = NDArray[np.float32]

MAX_SIDE = 16_384
"""Longest side in pixels that is read or written."""
MAX_PIXELS = 2**25
"""Most pixels that are read or written: 400 MB as float32 RGB."""
MAX_VALUES = 4 * MAX_PIXELS
"""Most values that are decoded, of all channels together: equal ones take next to nothing in a file."""

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_NPY_MAGIC = b"\x93NUMPY"


def read_picture(path: str | Path) -> Picture:
    """The picture in a file: EXR and NPY hold linear values, PNG sRGB.

    Of an EXR the channels R, G, B are taken. An alpha channel is accepted where it is 1 everywhere.
    Raises AnalysisError with one sentence for a file that is missing, is none of these, is truncated or
    damaged, has one channel, transparency, or too many pixels. Values that are not finite are not looked
    at here: the comparison says where they are.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except FileNotFoundError:
        raise AnalysisError(f"{path} does not exist") from None
    except OSError as error:
        raise AnalysisError(f"{path} cannot be read: {error.strerror}") from None
    for magic, read in _READERS.items():
        if start.startswith(magic):
            return read(path)
    raise AnalysisError(f"{path} is no picture that can be read, it must be an EXR, PNG or NPY file")


def srgb_from_linear(linear: NDArray[np.floating], exposure: float = 1.0) -> Picture:
    """sRGB values 0..1 of clip(exposure x linear)."""
    shown = np.clip(linear, 0, 1 / exposure).astype(np.float32) * np.float32(exposure)
    curved = np.float32(1.055) * shown ** np.float32(1 / 2.4) - np.float32(0.055)
    encoded: Picture = np.where(shown <= 0.0031308, np.float32(12.92) * shown, curved)
    return np.clip(encoded, 0, 1, out=encoded)


def linear_from_srgb(encoded: Picture) -> Picture:
    """Linear values of sRGB values 0..1."""
    curved = ((encoded + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    linear: Picture = np.where(encoded <= 0.04045, encoded / np.float32(12.92), curved)
    return linear


def tonemap_png(rgb: NDArray[np.floating], exposure: float, width: int | None = None) -> bytes:
    """PNG bytes of clip(exposure x linear) in sRGB.

    width   [px] the picture is averaged down to it, in linear light; a picture that is narrower already
            keeps its size, since enlarging adds nothing that a viewer cannot do

    Pixels that are not finite are shown black.
    """
    shown = np.clip(np.nan_to_num(rgb, nan=0, posinf=0, neginf=0), 0, 1 / exposure).astype(np.float32)
    if width is not None and width < shown.shape[1]:
        shown = _shrink(shown, width)
    return encode_png(np.rint(srgb_from_linear(shown, exposure) * 255).astype(np.uint8))


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """PNG bytes of (H, W) grey or (H, W, 3) sRGB values as they are."""
    _check_size("the picture to be written", pixels.shape[1], pixels.shape[0])
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, format="PNG")
    return out.getvalue()


def _shrink(picture: Picture, width: int) -> Picture:
    if width < 1:
        raise AnalysisError(f"the width is {width} pixels, it must be at least 1")
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    planes = [
        Image.fromarray(np.ascontiguousarray(picture[:, :, c])).resize((width, height), Image.Resampling.BOX)
        for c in range(3)
    ]
    return np.stack([np.asarray(plane, np.float32) for plane in planes], axis=2)


def _read_exr(path: Path) -> Picture:
    return _read_with_oiio(path, "EXR")


def _read_png(path: Path) -> Picture:
    _check_png_is_whole(path)
    return linear_from_srgb(_read_with_oiio(path, "PNG"))


def _read_with_oiio(path: Path, kind: str) -> Picture:
    """(H, W, 3) values as stored, PNG scaled to 0..1."""
    source: Any = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        OpenImageIO.geterror()  # takes the library's message, which otherwise surfaces at the next call
        raise AnalysisError(f"{path} is a damaged or truncated {kind} file, its header cannot be read")
    try:
        spec = source.spec()
        _check_size(str(path), spec.width, spec.height)
        _check_channels(path, spec.width * spec.height, spec.nchannels)  # all of them are decoded
        red, green, blue, alpha = _colour_channels(path, list(spec.channelnames))
        pixels = source.read_image("float")
        if pixels is None:
            reason = (source.geterror().splitlines() or ["pixels are missing"])[0]
            raise AnalysisError(f"{path} is a damaged or truncated {kind} file: {reason[:1].lower()}{reason[1:]}")
    finally:
        source.close()
    if alpha is not None and not (pixels[:, :, alpha] == 1).all():
        raise AnalysisError(f"{path} has transparent pixels, it must be opaque RGB")
    return np.ascontiguousarray(pixels[:, :, [red, green, blue]], dtype=np.float32)


def _check_channels(path: Path, pixels: int, channels: int) -> None:
    if pixels * channels > MAX_VALUES:
        raise AnalysisError(
            f"{path} has {channels} channels of {pixels:,} pixels, at most {MAX_VALUES:,} values are read"
        )


def _colour_channels(path: Path, names: list[str]) -> tuple[int, int, int, int | None]:
    """Places of R, G, B and of A (None where there is none) among a file's channels."""
    try:
        red, green, blue = (names.index(name) for name in "RGB")
    except ValueError:
        listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        count = "1 channel" if len(names) == 1 else f"{len(names)} channels"
        raise AnalysisError(f"{path} has {count} ({listed}), it must have R, G and B") from None
    return red, green, blue, names.index("A") if "A" in names else None


def check_png(path: Path) -> None:
    """For a PNG that is handed on as it is: raises AnalysisError as `read_picture` does, without decoding it."""
    _check_png_is_whole(path)
    with path.open("rb") as file:
        head = file.read(24)
    # The first chunk of every PNG is IHDR, which begins with width and height.
    _check_size(str(path), int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big"))


def _check_png_is_whole(path: Path) -> None:
    """Walk the chunks and their checksums.

    libpng would find the same faults, but prints them on its own to standard error.
    """
    content = path.read_bytes()
    place, kind = len(_PNG_MAGIC), b""
    while kind != b"IEND":
        head = content[place : place + 8]
        size, kind = int.from_bytes(head[:4], "big"), head[4:8]
        end = place + 8 + size
        checksum = content[end : end + 4]
        if len(checksum) < 4:
            raise AnalysisError(f"{path} is a truncated PNG file, it ends at byte {len(content)}")
        if zlib.crc32(content[place + 4 : end]) != int.from_bytes(checksum, "big"):
            raise AnalysisError(f"{path} is a damaged PNG file, a checksum near byte {place} is wrong")
        place = end + 4


def _read_npy(path: Path) -> Picture:
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError):
        raise AnalysisError(f"{path} is a damaged or truncated NPY file") from None
    if stored.ndim != 3 or stored.shape[2] != 3 or stored.dtype.kind != "f":
        raise AnalysisError(
            f"{path} holds {stored.dtype} of shape {stored.shape}, "
            "it must hold floats of shape (height, width, 3), linear RGB"
        )
    _check_size(str(path), stored.shape[1], stored.shape[0])
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinity, which the comparison names
        return np.array(stored, dtype=np.float32, order="C")


def _check_size(what: str, width: int, height: int) -> None:
    if min(width, height) < 1:
        raise AnalysisError(f"{what} is {width} x {height} pixels, it must have at least one")
    if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
        raise AnalysisError(
            f"{what} is {width} x {height} pixels, "
            f"it must have at most {MAX_SIDE:,} on a side and {MAX_PIXELS:,} in all"
        )


_READERS: dict[bytes, Callable[[Path], Picture]] = {
    _EXR_MAGIC: _read_exr,
    _PNG_MAGIC: _read_png,
    _NPY_MAGIC: _read_npy,
}
