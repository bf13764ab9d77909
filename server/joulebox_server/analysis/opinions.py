"""Second opinions: what other metrics say of the same pair of pictures."""

from dataclasses import asdict, dataclass
from typing import Any

import flip_evaluator
import numpy as np
import OpenImageIO
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from joulebox_server.analysis.difference import FIELD_OF_VIEW_DEG, check_pair
from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.analysis.images import srgb_from_linear

RELMSE_OFFSET = 0.01
RELMSE_DROPPED_SHARE = 0.001


@dataclass(frozen=True)
class Opinions:
    """Metrics without a unit; 0 (for ssim 1) where the pictures are equal.

    flip_mean   mean FLIP error (Andersson 2020) at its default of 67 pixels per degree, on sRGB, 0..1
    ssim        mean structural similarity (Wang 2004), 7x7 windows, on sRGB, -1..1
    rmse_srgb   root of the mean squared error over pixels and channels, on sRGB, 0..1
    relmse      on linear data, see `relative_mse`
    """

    flip_mean: float
    ssim: float
    rmse_srgb: float
    relmse: float

    def document(self) -> dict[str, float]:
        """The fields by name."""
        return asdict(self)


def second_opinions(reference: NDArray[np.floating], test: NDArray[np.floating], exposure: float = 1.0) -> Opinions:
    """Opinions on two (H, W, 3) scene-linear pictures shown at one exposure.

    sRGB means clip(exposure x linear) -> sRGB. Raises AnalysisError as `difference.compare` does.
    """
    check_pair(reference, test)
    shown_reference = srgb_from_linear(reference, exposure)
    shown_test = srgb_from_linear(test, exposure)
    # positional: LDR, inputs are sRGB, no colour map, compute the mean, defaults (67 pixels per degree)
    _, flip_mean, _ = flip_evaluator.evaluate(shown_reference, shown_test, "LDR", True, False, True, {})
    similarity = structural_similarity(  # type: ignore[no-untyped-call]
        shown_reference, shown_test, data_range=1.0, channel_axis=2
    )
    error = shown_reference - shown_test
    return Opinions(
        flip_mean=float(flip_mean),
        ssim=float(similarity),
        rmse_srgb=float(np.sqrt(np.mean(error * error, dtype=np.float64))),
        relmse=relative_mse(reference, test, exposure),
    )


def relative_mse(reference: NDArray[np.floating], test: NDArray[np.floating], exposure: float = 1.0) -> float:
    """Mean over pixels and channels of (e a - e b)^2 / ((e b)^2 + 0.01), b the reference, e the exposure.

    The worst 0.1 % of pixels (rounded down) are dropped, so that a few fireflies do not decide.
    """
    shown_reference = reference.astype(np.float64) * exposure
    error = test.astype(np.float64) * exposure - shown_reference
    per_pixel = (error**2 / (shown_reference**2 + RELMSE_OFFSET)).mean(axis=2).ravel()
    kept = per_pixel.size - int(per_pixel.size * RELMSE_DROPPED_SHARE)
    return float(np.partition(per_pixel, kept - 1)[:kept].mean())


def yee_failing_share(reference: NDArray[np.floating], test: NDArray[np.floating], exposure: float = 1.0) -> float:
    """Share of pixels, 0..1, in which Yee's metric (2004) sees a difference; slow.

    Shown as the difference shows them: clip(exposure x linear), 100 cd/m2, 8 degrees.
    """
    check_pair(reference, test)
    result = OpenImageIO.CompareResults()
    shown = [_image_buffer(np.clip(picture, 0, 1 / exposure) * exposure) for picture in (reference, test)]
    algorithms: Any = OpenImageIO.ImageBufAlgo  # the stub of compare_Yee lacks the two images
    algorithms.compare_Yee(*shown, result, 100.0, FIELD_OF_VIEW_DEG)
    if result.error:
        raise AnalysisError("OpenImageIO could not compute Yee's metric for these images")
    height, width = reference.shape[:2]
    return float(result.nfail / (height * width))


def _image_buffer(picture: NDArray[np.floating]) -> OpenImageIO.ImageBuf:
    height, width = picture.shape[:2]
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, height, 3, OpenImageIO.FLOAT))
    buffer.set_pixels(buffer.roi, np.ascontiguousarray(picture, dtype=np.float32))
    return buffer
