"""Pictures: linear RGB as (H, W, 3) float32, first row on top; OpenEXR and PNG through OpenImageIO."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - the name its documentation uses

from joulebox_render.errors import ImageError
from joulebox_render.records import F4, U1

_NO_METADATA: Mapping[str, str] = MappingProxyType({})


def pixel_sha256(rgb: npt.ArrayLike) -> str:
    """SHA-256 over the float32 little-endian RGB rows, first row on top."""
    return hashlib.sha256(np.ascontiguousarray(rgb, dtype="<f4").tobytes()).hexdigest()


def write_exr(path: Path | str, rgb: F4, metadata: Mapping[str, str] = _NO_METADATA) -> None:
    """Write linear RGB (H, W, 3) as float32 OpenEXR with zip compression.

    metadata  text attributes of the file, for example {"joulebox:settings": "{...}"}
    The file appears whole or not at all. Raises ImageError when it cannot be written.
    """
    pixels = np.ascontiguousarray(_checked(rgb), dtype=np.float32)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float")
    spec.attribute("compression", "zip")
    for name, value in metadata.items():
        spec.attribute(name, value)
    _write_whole(Path(path), ".exr", spec, pixels)


def write_png(path: Path | str, rgb: F4, exposure: float) -> None:
    """Write linear RGB (H, W, 3) times `exposure`, clipped to 0..1 and sRGB-encoded, as 8-bit PNG.

    The file appears whole or not at all. Raises ImageError when it cannot be written.
    """
    pixels = srgb_bytes(_checked(rgb), exposure)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    _write_whole(Path(path), ".png", spec, pixels)


def srgb_bytes(rgb: F4, exposure: float) -> U1:
    """(H, W, 3) 8-bit sRGB of clip(exposure x linear); NaN is shown black. Source: IEC 61966-2-1."""
    linear = np.clip(np.nan_to_num(exposure * rgb.astype(np.float64), nan=0.0), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def read_exr(path: Path | str) -> F4:
    """The R, G and B channels of an OpenEXR file as (H, W, 3) float32; ImageError when it cannot be read."""
    pixels = _read(Path(path), "openexr", "float")
    return np.ascontiguousarray(pixels, dtype=np.float32)


def _checked(rgb: F4) -> F4:
    if rgb.ndim != 3 or rgb.shape[2] != 3 or 0 in rgb.shape:
        raise ImageError(f"a picture has the shape (height, width, 3), not {rgb.shape}")
    return rgb


def _write_whole(path: Path, suffix: str, spec: oiio.ImageSpec, pixels: npt.NDArray[Any]) -> None:
    """Write beside `path`, read back, and rename: OpenImageIO does not report a full disk."""
    if path.suffix.lower() != suffix:
        raise ImageError(f"{path}: this picture needs a name that ends in {suffix}")
    if not path.parent.is_dir():
        raise ImageError(f"{path}: there is no folder {path.parent}; make it first")
    if path.is_dir():
        raise ImageError(f"{path}: this is a folder; give the name of a file")
    partial = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{suffix}")
    try:
        _write(partial, spec, pixels)
        os.replace(partial, path)
    except OSError as error:
        raise ImageError(f"{path}: cannot be written ({error.strerror or error})") from None
    except ImageError as error:
        raise ImageError(f"{path}: cannot be written ({error})") from None
    finally:
        partial.unlink(missing_ok=True)


def _write(path: Path, spec: oiio.ImageSpec, pixels: npt.NDArray[Any]) -> None:
    # The operating system's own word on folders and permissions is clearer than the library's.
    path.touch(exist_ok=False)
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise ImageError(_reason(oiio.geterror()))
    written = output.open(str(path), spec) and output.write_image(pixels)
    if not (output.close() and written):
        raise ImageError(_reason(output.geterror()))
    try:
        kept = _read(path, output.format_name(), str(spec.format))
    except ImageError:
        kept = None
    if kept is None or not np.array_equal(kept, pixels, equal_nan=pixels.dtype.kind == "f"):
        raise ImageError("the file does not hold what was written; is the disk full?")


def _read(path: Path, format_name: str, pixel_type: str) -> npt.NDArray[Any]:
    """(H, W, 3) R, G and B of a file that must be of one format."""
    if not path.is_file():
        raise ImageError(f"{path}: there is no such file")
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ImageError(f"{path}: not a readable picture ({_reason(oiio.geterror())})")
    try:
        spec = source.spec()
        if source.format_name() != format_name:
            raise ImageError(f"{path}: this is a file of type {source.format_name()}, not {format_name}")
        names = list(spec.channelnames)
        if any(channel not in names for channel in "RGB"):
            raise ImageError(f"{path}: it has the channels {', '.join(names)}; R, G and B are needed")
        pixels = source.read_image(0, 0, 0, spec.nchannels, pixel_type)
        if pixels is None:
            raise ImageError(f"{path}: the picture is damaged or cut off ({_reason(source.geterror())})")
        return np.asarray(pixels)[..., [names.index(channel) for channel in "RGB"]]
    finally:
        source.close()


def _reason(text: str) -> str:
    return " ".join(text.split()).rstrip(".") or "no reason given"
