"""Contrast sensitivity of the eye, the inverse of the contrast that is just seen.

Frequencies in cycles per degree, luminances in cd/m2. Achromatic: Barten 1989. Red-green and blue-yellow:
Johnson & Fairchild 2003, scaled with luminance as the achromatic sensitivity at 4 cycles per degree.
"""

import numpy as np
from numpy.typing import NDArray

ACHROMATIC_GAIN = 0.62
CHROMATIC_ANCHOR_CPD = 4.0
CHROMATIC_ANCHOR_CD_M2 = 100.0

Field = NDArray[np.float32]


def achromatic(frequency_cpd: float, luminance_cd_m2: Field) -> Field:
    """S_A(f, L), one value for every luminance."""
    a = 540 / (1 + 12 / (8 * (1 + frequency_cpd / 3) ** 2)) * (1 + np.float32(0.7) / luminance_cd_m2) ** -0.2
    bf = np.float32(0.3 * frequency_cpd) * (1 + np.float32(100) / luminance_cd_m2) ** np.float32(0.15)
    falling = np.exp(-bf)
    # exp(-bf) sqrt(1 + 0.06 exp(bf)) written so that exp(bf) cannot overflow at high frequencies
    out: Field = (
        np.float32(ACHROMATIC_GAIN * frequency_cpd) * a * np.sqrt(falling * falling + np.float32(0.06) * falling)
    )
    return out.astype(np.float32, copy=False)


def chromatic(frequency_cpd: float, luminance_cd_m2: Field) -> tuple[Field, Field]:
    """Red-green and blue-yellow sensitivity, one value for every luminance."""
    f = frequency_cpd
    red_green = 109.1413 * np.exp(-0.00038 * f**3.42436) + 93.59711 * np.exp(-0.00367 * f**2.16771)
    blue_yellow = 7.032845 * np.exp(-0.000004 * f**4.258205) + 40.69095 * np.exp(-0.103909 * f**1.648658)
    anchor = achromatic(CHROMATIC_ANCHOR_CPD, np.array([CHROMATIC_ANCHOR_CD_M2], np.float32))
    adaptation = achromatic(CHROMATIC_ANCHOR_CPD, luminance_cd_m2) / anchor[0]
    return np.float32(red_green) * adaptation, np.float32(blue_yellow) * adaptation
