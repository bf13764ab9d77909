"""Linear models of windows in time order whose errors are partly drift, and what drift does to a mean.

Errors are the sum of white noise, independent from window to window, and of an Ornstein-Uhlenbeck process
(exponentially forgotten, here "drift") whose size and correlation time are unknown. A few windows cannot tell
both, so every size and time of a grid is weighed by its likelihood and the results are averaged: where the
data show no drift little changes, where they show some the interval becomes as wide as it has to be.
Source: Harville 1974 (likelihood with the means integrated out); Hoeting et al. 1999, "Bayesian model averaging".
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Floats = NDArray[np.float64]
TIMES_S = (30.0, 60.0, 120.0, 240.0, 480.0)  # correlation times tried
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # variances of the drift tried, in units of one row's white variance


@dataclass(frozen=True)
class LinearFit:
    """Coefficients (p,) of y = X b, their covariance (p, p), the variance of one row, its degrees of freedom.

    correlation  (n, n) of the errors, averaged over the grid and in units of the white variance
    """

    coefficients: Floats
    covariance: Floats
    row_variance: float
    degrees_of_freedom: int
    correlation: Floats


@dataclass(frozen=True)
class _Model:
    """One point of the grid: errors' covariance (n, n) in units of the white variance, its prior weight."""

    covariance: Floats
    prior: float


def fit(design: Floats, values: Floats, starts_s: Floats, lengths_s: Floats, without_drift: float) -> LinearFit:
    """Generalised least squares of `values` (n,) on `design` (n, p), averaged over the grid of drifts.

    starts_s, lengths_s  of the rows [s]; white noise of a row falls with its length
    without_drift        prior probability that there is none
    Raises numpy.linalg.LinAlgError when the columns of the design are dependent.
    """
    rows, columns = design.shape
    freedom = rows - columns
    white = np.diag(np.mean(lengths_s) / lengths_s)
    models = list(_models(white, starts_s, lengths_s, without_drift))
    log_weights, means, covariances, row_variances = [], [], [], []
    for model in models:
        factor = cho_factor(model.covariance, lower=True)
        information = design.T @ cho_solve(factor, design)
        inverse = np.linalg.inv(information)
        mean = inverse @ (design.T @ cho_solve(factor, values))
        rest = values - design @ mean
        square = max(float(rest @ cho_solve(factor, rest)), 1e-12 * float(values @ values) + 1e-300)
        log_det = 2 * float(np.log(np.diag(factor[0])).sum()) + float(np.linalg.slogdet(information)[1])
        log_weights.append(np.log(model.prior) - 0.5 * log_det - 0.5 * freedom * np.log(square))
        means.append(mean)
        covariances.append(inverse * square / freedom)
        row_variances.append(float(np.trace(model.covariance)) / rows * square / freedom)
    weights = np.exp(np.array(log_weights) - max(log_weights))
    weights /= weights.sum()
    mean = np.tensordot(weights, np.array(means), 1)
    spread = np.array(means) - mean
    covariance = np.tensordot(weights, np.array(covariances), 1) + np.einsum("m,mi,mj->ij", weights, spread, spread)
    correlation = np.tensordot(weights, np.array([model.covariance for model in models]), 1)
    return LinearFit(mean, covariance, float(weights @ np.array(row_variances)), freedom, correlation)


def _models(white: Floats, starts_s: Floats, lengths_s: Floats, without_drift: float) -> Iterator[_Model]:
    """No drift, then every size and time, the rest of the prior shared among them."""
    yield _Model(white, without_drift)
    prior = (1 - without_drift) / (len(TIMES_S) * len(SIZES))
    for time_s in TIMES_S:
        shape = drift_covariance(starts_s, lengths_s, time_s)
        for size in SIZES:
            yield _Model(white + size * shape, prior)


def drift_covariance(starts_s: Floats, lengths_s: Floats, time_s: float) -> Floats:
    """Covariance (n, n) of the averages of an Ornstein-Uhlenbeck process of variance 1 over stretches of time.

    The stretches do not overlap. Exact: the double integral of exp(-|s - t| / time_s) over each pair.
    """
    x = lengths_s / time_s
    middles_s = starts_s + lengths_s / 2
    apart = np.abs(middles_s[:, None] - middles_s[None, :])
    within = 2 * np.sinh(x / 2) / x
    with np.errstate(over="ignore", invalid="ignore"):
        covariance = np.exp(-apart / time_s) * within[:, None] * within[None, :]
    np.fill_diagonal(covariance, 2 * (x - 1 + np.exp(-x)) / x**2)
    return covariance
