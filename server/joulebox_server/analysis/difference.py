"""Perceptual difference of two pictures: "ltdiff-style", version 1.

The thesis this work grew from measured degradation with ltdiff (Lindstrom 2000): a sum without a unit, 0
for equal pictures, 100 the acceptable limit at 256x256. That program cannot be had. This is a metric in
the lineage of Lubin 1995, Daly 1993 and Bolin & Meyer 1998, scaled to the thesis' published anchors; its
"100" agrees with ltdiff's to about a factor of three and means *acceptable*, not *invisible*.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulebox_server.analysis import sensitivity
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.pyramid import Stack, expand, reduce, smooth

METRIC = "ltdiff-style"
VERSION = 1

FIELD_OF_VIEW_DEG = 8.0
"""Angle that the short side fills unless the display says otherwise."""
LIMIT_AT_256 = 100.0
"""Acceptable difference of a picture of 256x256 pixels (thesis)."""
MIN_SIDE = 16
"""Shortest side in pixels: below it the pyramid has no band at all."""
DELTA_WHITE_JND = 10.0

_COARSEST_CPD = 0.3
_COARSEST_PIXELS = 8
_POOLING = 2.4
_MASKING = 2.8
_CEILING_JND = 20.0
_FLOOR_JND = 1e-3
_VALUE_SCALE = 2.0e-5
VALUE_EXPONENT = 3.5

_RANGES = {
    "exposure": (1e-6, 1e6, ""),
    "peak_cd_m2": (1.0, 10_000.0, " cd/m2"),
    "black_cd_m2": (1e-3, 1000.0, " cd/m2"),
    "pixels_per_degree": (1.0, 1000.0, ""),
}

_XYZ_FROM_REC709 = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_CONES_FROM_XYZ = np.array([[0.38971, 0.68898, -0.07868], [-0.22981, 1.18340, 0.04641], [0.0, 0.0, 1.0]])


def _opponent_from_rec709() -> NDArray[np.float32]:
    """Matrix to A = Y, C1 = L - M, C2 = S - (L + M)/2, cones (Hunt-Pointer-Estevez) scaled to 1 for white."""
    cones = _CONES_FROM_XYZ @ _XYZ_FROM_REC709
    long, medium, short = cones / cones.sum(axis=1, keepdims=True)
    luminance = _XYZ_FROM_REC709[1]
    return np.array([luminance, long - medium, short - (long + medium) / 2], dtype=np.float32)


_OPPONENT_FROM_REC709 = _opponent_from_rec709()


@dataclass(frozen=True)
class Display:
    """How both pictures are shown; it is stored with every value.

    exposure            factor on scene-linear values, one for both pictures
    peak_cd_m2          [cd/m2] luminance of linear 1, where values are clipped
    black_cd_m2         [cd/m2] black level plus veil, added to the luminance
    pixels_per_degree   None: the short side fills 8 degrees (32 at 256x256)

    Raises AnalysisError for a number out of range.
    """

    exposure: float = 1.0
    peak_cd_m2: float = 100.0
    black_cd_m2: float = 1.0
    pixels_per_degree: float | None = None

    def __post_init__(self) -> None:
        for name, (lowest, highest, unit) in _RANGES.items():
            value = getattr(self, name)
            if value is None and name == "pixels_per_degree":
                continue
            if not lowest <= value <= highest:  # also refuses NaN
                raise AnalysisError(f"{name} is {value}, it must be from {lowest:g} to {highest:g}{unit}")

    def resolution(self, height: int, width: int) -> float:
        """Pixels per degree for a picture of this size."""
        return self.pixels_per_degree or min(height, width) / FIELD_OF_VIEW_DEG

    def document(self, height: int, width: int) -> dict[str, Any]:
        """What is stored beside a value, with the pixels per degree that were used."""
        return {
            "exposure": self.exposure,
            "peak_cd_m2": self.peak_cd_m2,
            "black_cd_m2": self.black_cd_m2,
            "pixels_per_degree": self.resolution(height, width),
            "tone_map": "clip",
        }


@dataclass(frozen=True, eq=False)
class Difference:
    """A difference and what a sum alone would hide.

    value               the sum over the picture; 0 for equal pictures
    value_per_pixel     the number that does not grow with the resolution
    max_jnd, p99_jnd    largest and 99th percentile of the map
    share_above_3_jnd   share of pixels above 3, 0..1
    limit               acceptable value at this size: 100 x width x height / 65,536
    acceptable          value <= limit; it does not mean that the difference is invisible
    jnd                 (H, W) just noticeable differences, 0..20
    """

    value: float
    value_per_pixel: float
    max_jnd: float
    p99_jnd: float
    share_above_3_jnd: float
    limit: float
    acceptable: bool
    jnd: NDArray[np.float32]


def acceptable_limit(width: int, height: int, at_256: float = LIMIT_AT_256) -> float:
    """Acceptable difference of a picture of this size, the field of view being the same."""
    return at_256 * width * height / 65536


def compare(reference: NDArray[np.floating], test: NDArray[np.floating], display: Display) -> Difference:
    """Difference of `test` to `reference`, both (H, W, 3) scene-linear Rec.709; symmetric in the two.

    Raises AnalysisError when a picture is not (H, W, 3), the sizes differ, a side is below 16 pixels or a
    pixel is not finite.
    """
    check_pair(reference, test)
    jnd = _jnd_map(reference, test, display)
    height, width = jnd.shape
    value = _VALUE_SCALE * float((jnd ** np.float32(VALUE_EXPONENT)).sum(dtype=np.float64))
    limit = acceptable_limit(width, height)
    return Difference(
        value=value,
        value_per_pixel=value / (height * width),
        max_jnd=float(jnd.max()),
        p99_jnd=float(np.percentile(jnd, 99)),
        share_above_3_jnd=float((jnd > 3).mean()),
        limit=limit,
        acceptable=value <= limit,
        jnd=jnd,
    )


def delta_image(jnd: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W) picture of the map on a fixed scale: black is equal, white 10 just noticeable differences."""
    scaled = np.clip(jnd / np.float32(DELTA_WHITE_JND), 0, 1) * np.float32(255)
    delta: NDArray[np.uint8] = np.rint(scaled).astype(np.uint8)
    return delta


def check_pair(reference: NDArray[np.floating], test: NDArray[np.floating]) -> None:
    """Raise AnalysisError unless both are (H, W, 3), of one size of at least 16 x 16, and finite."""
    for name, picture in (("reference", reference), ("test", test)):
        if picture.ndim != 3 or picture.shape[2] != 3:
            raise AnalysisError(f"the {name} image has shape {picture.shape}, it must be (height, width, 3) linear RGB")
    if reference.shape != test.shape:
        (h, w), (test_h, test_w) = reference.shape[:2], test.shape[:2]
        raise AnalysisError(
            f"the reference image is {w} x {h} pixels and the test image {test_w} x {test_h}, they must be of one size"
        )
    height, width = reference.shape[:2]
    if min(height, width) < MIN_SIDE:
        raise AnalysisError(
            f"the images are {width} x {height} pixels, the difference needs at least {MIN_SIDE} x {MIN_SIDE}"
        )
    check_finite("reference", reference)
    check_finite("test", test)


def check_finite(name: str, picture: NDArray[np.floating]) -> None:
    """Raise AnalysisError that says where the first pixel is that is not a finite number."""
    # a finite sum proves that every term is finite, and costs a fraction of looking at each
    with np.errstate(invalid="ignore"):  # infinities of both signs
        total = picture.sum(dtype=np.float64)
    if np.isfinite(total):
        return
    bad = ~np.isfinite(picture).all(axis=2)
    if not bad.any():
        return
    row, column = np.argwhere(bad)[0]
    count = int(bad.sum())
    pixels = "1 pixel" if count == 1 else f"{count} pixels"
    raise AnalysisError(
        f"the {name} image has {pixels} with NaN or infinity, the first at row {row}, column {column} "
        "(counted from 0, top left); every pixel must be finite"
    )


def _jnd_map(reference: NDArray[np.floating], test: NDArray[np.floating], display: Display) -> NDArray[np.float32]:
    """(H, W) map of just noticeable differences, step by step as the definition numbers them."""
    height, width = reference.shape[:2]
    levels = [np.concatenate([_opponent(reference, display), _opponent(test, display)])]  # steps 1, 2
    frequencies, residual_frequency = _frequencies(height, width, display.resolution(height, width))
    for _ in frequencies:
        levels.append(reduce(levels[-1]))  # step 3

    pooled = _visible(levels[-1], _luminance(levels[-1], display), residual_frequency, masked=False)
    for fine, coarse, frequency in zip(levels[-2::-1], levels[:0:-1], frequencies[::-1], strict=True):
        size = fine.shape[1:]
        low = expand(coarse, *size)
        visible = _visible(fine - low, _luminance(low, display), frequency, masked=True)  # steps 4, 5, 6
        pooled = expand(pooled, *size) + visible  # step 7: the sum of powers is expanded, not the map

    jnd: NDArray[np.float32] = pooled[0] ** np.float32(1 / _POOLING)
    jnd /= np.sqrt(np.sqrt(1 + (jnd / np.float32(_CEILING_JND)) ** 4))
    jnd[jnd < _FLOOR_JND] = 0
    return jnd


def _opponent(picture: NDArray[np.floating], display: Display) -> Stack:
    """(3, H, W) opponent channels A, C1, C2 of the displayed picture [cd/m2]."""
    # clipped before it is scaled: what is far too bright cannot overflow
    shown = np.clip(picture.reshape(-1, 3), 0, 1 / display.exposure).astype(np.float32)
    shown *= np.float32(display.exposure)
    matrix = _OPPONENT_FROM_REC709 * np.float32(display.peak_cd_m2)
    channels: Stack = (matrix @ shown.T).reshape(3, *picture.shape[:2])
    channels[0] += np.float32(display.black_cd_m2)
    return channels


def _frequencies(height: int, width: int, pixels_per_degree: float) -> tuple[list[float], float]:
    """Centre frequency of every band, finest first, and of the residual [cycles per degree]."""
    frequencies: list[float] = []
    following = 0.33 * pixels_per_degree
    while following >= _COARSEST_CPD and (min(height, width) + 1) // 2 >= _COARSEST_PIXELS:
        frequencies.append(following)
        height, width = (height + 1) // 2, (width + 1) // 2
        following = 0.25 * pixels_per_degree / 2 ** len(frequencies)
    return frequencies, following


def _luminance(level: Stack, display: Display) -> NDArray[np.float32]:
    """(H, W) local luminance: mean of both pictures, at least black [cd/m2]."""
    mean: NDArray[np.float32] = np.float32(0.5) * (level[0] + level[3])
    return np.maximum(mean, np.float32(display.black_cd_m2), out=mean)


def _visible(band: Stack, luminance: NDArray[np.float32], frequency: float, masked: bool) -> Stack:
    """(1, H, W) sum over channels of d^2.4, d the difference of a band in threshold units.

    band (6, H, W): three channels of the reference, then of the test; overwritten.
    """
    red_green, blue_yellow = sensitivity.chromatic(frequency, luminance)
    per_contrast = np.stack([sensitivity.achromatic(frequency, luminance), red_green, blue_yellow])
    per_contrast /= luminance
    difference = np.abs(band[:3] - band[3:])
    difference *= per_contrast
    with np.errstate(divide="ignore"):  # log 0 = -inf is meant: no difference stays exactly 0
        exponent = np.log(difference, out=difference)
        exponent *= np.float32(_POOLING)
        if masked:
            both = smooth(np.abs(band, out=band))
            mask = np.minimum(both[:3], both[3:])
            mask *= per_contrast
            powered = np.exp(np.float32(_MASKING) * np.log(mask, out=mask))
            exponent -= np.float32(_POOLING / 4) * np.log1p(powered)
    total: Stack = np.exp(exponent, out=exponent).sum(axis=0, keepdims=True)
    return total
