"""Linear models of windows in time order whose errors are partly drift, and what drift does to a mean.

Errors are the sum of white noise, independent from window to window, and of an Ornstein-Uhlenbeck process
(exponentially forgotten, here "drift") whose size and correlation time are unknown. A few windows cannot tell
both, so every size and time of a grid is weighed by its likelihood and the results are averaged.
Source: Harville 1974 (likelihood with the means integrated out); Hoeting et al. 1999, "Bayesian model averaging".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulebox_agent.estimates.estimate import mixture_half_width

Floats = NDArray[np.float64]
TIMES_S = (30.0, 60.0, 120.0, 240.0, 480.0)  # correlation times tried
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # variances of the drift tried, in units of one row's white variance
PIECE_SIZES = (0.03, *SIZES[:-1])  # the same for pieces of windows, whose white variance is larger
FEWEST_PIECES = 8  # fewer tell nothing, and even odds of nothing are no evidence
BELIEVED = 3.0  # odds of drift against none, even beforehand, that count as evidence (Kass and Raftery 1995)


@dataclass(frozen=True)
class LinearFit:
    """Coefficients (p,) of y = X b, their covariance (p, p), the variance of one row, its degrees of freedom.

    weights      (m,) posterior probability of each point of the grid
    ratios       (m, n, n) covariance of the errors there, in units of the white variance
    """

    coefficients: Floats
    covariance: Floats
    row_variance: float
    degrees_of_freedom: int
    weights: Floats
    ratios: Floats


@dataclass(frozen=True)
class _Grid:
    """Models of the errors of n rows, the one without drift first.

    covariances, inverses         (m, n, n) in units of the white variance
    log_determinants, log_priors  (m,) of the inverses, of the prior probabilities
    """

    covariances: Floats
    inverses: Floats
    log_determinants: Floats
    log_priors: Floats


@dataclass(frozen=True)
class _Posterior:
    """By model: weights (m,), coefficients (m, p), their unscaled covariance (m, p, p), white variance (m,)."""

    weights: Floats
    means: Floats
    unscaled: Floats
    scales: Floats


def fit(design: Floats, values: Floats, starts_s: Floats, lengths_s: Floats, without_drift: float) -> LinearFit:
    """Generalised least squares of `values` (n,) on `design` (n, p), averaged over the grid of drifts.

    starts_s, lengths_s  of the rows [s]; white noise of a row falls with its length
    without_drift        prior probability that there is none
    Raises numpy.linalg.LinAlgError when the columns of the design are dependent.
    """
    grid = _grid(starts_s, lengths_s, TIMES_S, SIZES, without_drift)
    known = _posterior(grid, design, values)
    mean = known.weights @ known.means
    spread = known.means - mean
    covariance = np.tensordot(known.weights * known.scales, known.unscaled, 1)
    covariance += np.einsum("m,mi,mj->ij", known.weights, spread, spread)
    variances = known.weights * known.scales * np.trace(grid.covariances, axis1=1, axis2=2)
    freedom = design.shape[0] - design.shape[1]
    return LinearFit(mean, covariance, float(variances.sum()) / len(values), freedom, known.weights, grid.covariances)


def half_share(views: Sequence[Floats], starts_s: Floats, lengths_s: Floats, window_s: float) -> float:
    """Half-width of the 95 % interval of a mean that drift asks for, as a share of the mean; 0 where none shows.

    views                looks (n,) at the same pieces of windows: joules an image and watts, of gauge and counter.
                         Drift of the machine shows in each, and whichever is quietest shows it first
    starts_s, lengths_s  of the pieces, all windows cut into the same number of equal parts
    window_s             length of a window: drift that is forgotten within half of it is in the windows' own spread

    A view shows drift when the odds for it reach BELIEVED. Its half-width is then the 95 % quantile of the mean's
    error, a Student's t for every size and time of the grid, weighed by their posterior; the widest view's is taken.
    Without drift one pilot of five windows in ten is widened, mostly one whose spread is wide by itself: it adds
    0.3 % to the coverage. With 2 % of drift over two minutes nine in ten are.
    """
    count = len(starts_s)
    times_s = [time_s for time_s in TIMES_S if time_s >= window_s / 2]
    views = [view / np.mean(view) for view in views if np.ptp(view) > 0 and np.mean(view) > 0]
    if count < FEWEST_PIECES or not times_s or not views:
        return 0.0
    grid = _grid(starts_s, lengths_s, times_s, PIECE_SIZES, 0.5)
    of_mean = grid.covariances.mean(axis=(1, 2))[1:]
    widest = 0.0
    for view in views:
        known = _posterior(grid, np.ones((count, 1)), view)
        weights = known.weights[1:]
        if weights.sum() < BELIEVED * known.weights[0]:
            continue
        errors = np.sqrt(known.scales[1:] * of_mean)
        widest = max(widest, mixture_half_width(weights / weights.sum(), errors, count - 1))
    return widest


def _posterior(grid: _Grid, design: Floats, values: Floats) -> _Posterior:
    """Weighs the models by their likelihood with the coefficients and the white variance integrated out."""
    freedom = design.shape[0] - design.shape[1]
    weighted = design.T @ grid.inverses  # (m, p, n)
    unscaled = np.asarray(np.linalg.inv(weighted @ design), dtype=np.float64)
    means = (unscaled @ (weighted @ values)[:, :, None])[:, :, 0]
    rests = values - means @ design.T
    floor = 1e-12 * float(values @ values) + 1e-300  # values that fit exactly have errors all the same
    squares = np.maximum(np.einsum("mi,mij,mj->m", rests, grid.inverses, rests, optimize=True), floor)
    log_weights = grid.log_priors - 0.5 * freedom * np.log(squares)
    log_weights += 0.5 * (grid.log_determinants + np.linalg.slogdet(unscaled)[1])
    weights: Floats = np.exp(log_weights - log_weights.max())
    return _Posterior(weights / weights.sum(), means, unscaled, squares / freedom)


def _grid(
    starts_s: Floats, lengths_s: Floats, times_s: Sequence[float], sizes: Sequence[float], without_drift: float
) -> _Grid:
    """No drift, and every size at every time; they share what the prior leaves them."""
    white = np.diag(np.mean(lengths_s) / lengths_s)
    shapes = [drift_covariance(starts_s, lengths_s, time_s) for time_s in times_s]
    covariances = np.array([white, *(white + size * shape for shape in shapes for size in sizes)])
    priors = np.full(len(covariances), (1 - without_drift) / (len(covariances) - 1))
    priors[0] = without_drift
    return _Grid(covariances, np.linalg.inv(covariances), -np.linalg.slogdet(covariances)[1], np.log(priors))


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
