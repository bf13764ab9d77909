"""Regression over settings: effects of each setting, and of settings together where the data supports them.

A Gaussian process whose covariance is a product over settings,

    k(x, x') = s0^2 + s^2 prod_i (1 + a_i c_i(x, x')),

c_i being 1 for equal values and falling with the distance of numbers (of words: 0). Multiplied out, it is a sum over
every set of settings: a_i is how strong setting i is, and a_i a_j how strong i and j are together, beyond each alone.
With small a and large s the effects add up; whether they do follows from the data by maximum marginal likelihood.
Source: Rasmussen & Williams 2006, chapters 2 and 5; the kernel: Stitson et al. 1999, Duvenaud et al. 2011.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

Array = NDArray[np.float64]

_OFFSET_VARIANCE = 100.0
_JITTER = 1e-8
_PULL = 0.02
ENOUGH = 150
"""Rows that the strengths are chosen by."""
_TIGHT, _WIDE = np.log(1e-3), np.log(30.0)


@dataclass(frozen=True)
class Factor:
    """One setting's values by place: numbers on a scale of 0..1, or words, which have no order."""

    places: Array | None

    def distances(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> Array:
        """(n, m) squared distances of values that are given by place; infinite between different words."""
        if self.places is None:
            return np.where(one[:, None] == other[None, :], 0.0, np.inf)
        return np.asarray((self.places[one][:, None] - self.places[other][None, :]) ** 2)


@dataclass(frozen=True)
class Strengths:
    """What the likelihood chose: see the module; `reach` is how far values are alike, as a share of their range."""

    effects: Array
    scale: float
    reach: float
    noise: float

    @classmethod
    def from_logs(cls, logs: Array) -> "Strengths":
        """From the vector that is optimised."""
        return cls(np.exp(logs[:-3]), float(np.exp(logs[-3])), float(np.exp(logs[-2])), float(np.exp(logs[-1])))


@dataclass(frozen=True)
class Prediction:
    """Means and standard deviations of the quantity itself, its noise left out."""

    mean: Array
    sd: Array


class Anova:
    """A fitted regression. Rows of `codes` are configurations, columns the places of their values on the axes."""

    def __init__(
        self,
        factors: list[Factor],
        codes: NDArray[np.intp],
        target: Array,
        noise_variance: Array,
        strengths: Strengths | None = None,
        enough: int = ENOUGH,
    ) -> None:
        """Fit to `target` (n,), each known with `noise_variance` (n,); more noise is added if the data asks for it.

        strengths   where they were chosen before
        enough      rows that they are chosen by
        """
        self._factors, self._codes = factors, codes
        self._mean = float(target.mean())
        self._scale = max(float(target.std()), 1e-6)
        self._target = (target - self._mean) / self._scale
        self._noise = noise_variance / self._scale**2
        self.strengths = strengths or self._fitted(enough)
        covariance = self._covariance(codes, codes, self.strengths)
        self._factor = cho_factor(covariance + np.diag(self._noise + self.strengths.noise**2 + _JITTER), lower=True)
        self._weights = cho_solve(self._factor, self._target)

    @property
    def log_likelihood(self) -> float:
        """Of the target, up to a constant."""
        spread = float(np.log(np.diag(self._factor[0])).sum())
        return -0.5 * float(self._target @ self._weights) - spread - len(self._target) * float(np.log(self._scale))

    def predict(self, codes: NDArray[np.intp]) -> Prediction:
        """At configurations that may never have been measured."""
        across = self._covariance(codes, self._codes, self.strengths)
        solved = cho_solve(self._factor, across.T)
        prior = _variance(self.strengths)
        variance = np.maximum(prior - np.einsum("ij,ji->i", across, solved), _JITTER) + self.strengths.noise**2
        return Prediction(self._mean + self._scale * (across @ self._weights), self._scale * np.sqrt(variance))

    def steadied(self) -> Prediction:
        """At what was measured: each value drawn towards what the others say, as far as its own noise asks for it."""
        signal = self._covariance(self._codes, self._codes, self.strengths)
        signal[np.diag_indices_from(signal)] += self.strengths.noise**2
        variance = np.diag(signal) - np.einsum("ij,ji->i", signal, cho_solve(self._factor, signal))
        deviation = self._scale * np.sqrt(np.maximum(variance, _JITTER))
        return Prediction(self._mean + self._scale * (signal @ self._weights), deviation)

    def left_out(self) -> Prediction:
        """At what was measured, as all others predict it (Rasmussen & Williams 2006, eq. 5.12)."""
        inverse = np.diag(cho_solve(self._factor, np.eye(len(self._target))))
        mean = self._mean + self._scale * (self._target - self._weights / inverse)
        return Prediction(mean, self._scale * np.sqrt(np.maximum(1 / inverse - self._noise, _JITTER)))

    def _fitted(self, enough: int) -> Strengths:
        count = len(self._factors)
        start = np.concatenate([np.full(count, np.log(0.7)), np.log([0.3, 0.7, 0.1])])
        bounds = [(_TIGHT, _WIDE)] * (count + 1) + [(np.log(0.2), np.log(3.0)), (_TIGHT, 0.0)]
        rows = np.random.default_rng(0).permutation(len(self._target))[:enough]  # more would only take longer
        distances = self._distances(self._codes[rows], self._codes[rows])
        data = (distances, self._target[rows], self._noise[rows])
        found = minimize(self._loss, start, data, "L-BFGS-B", jac=True, bounds=bounds, options={"maxiter": 60})
        return Strengths.from_logs(found.x)

    @staticmethod
    def _loss(logs: Array, distances: list[Array], target: Array, known_noise: Array) -> tuple[float, Array]:
        """Negative log marginal likelihood and its gradient; a faint pull to 1 keeps flat directions in place."""
        strengths = Strengths.from_logs(logs)
        parts = _parts(distances, strengths)
        noise = strengths.noise**2
        covariance = _total(parts, strengths)
        try:
            factor = cho_factor(covariance + np.diag(known_noise + noise + _JITTER), lower=True)
        except np.linalg.LinAlgError:
            return 1e10, np.zeros_like(logs)
        weights = cho_solve(factor, target)
        loss = 0.5 * float(target @ weights) + float(np.log(np.diag(factor[0])).sum())
        outer = cho_solve(factor, np.eye(len(weights))) - np.outer(weights, weights)
        slopes = [0.5 * float(np.sum(outer * slope)) for slope in _slopes(parts, distances, strengths)]
        slopes.append(noise * float(np.trace(outer)))
        return loss + _PULL * float(logs @ logs), np.array(slopes) + 2 * _PULL * logs

    def _distances(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> list[Array]:
        return [factor.distances(one[:, k], other[:, k]) for k, factor in enumerate(self._factors)]

    def _covariance(self, one: NDArray[np.intp], other: NDArray[np.intp], strengths: Strengths) -> Array:
        return _total(_parts(self._distances(one, other), strengths), strengths)


def _parts(distances: list[Array], strengths: Strengths) -> list[Array]:
    """a_i c_i of every setting."""
    reach = -0.5 / strengths.reach**2
    return [a * np.exp(reach * distance) for a, distance in zip(strengths.effects, distances, strict=True)]


def _total(parts: list[Array], strengths: Strengths) -> Array:
    """The covariance."""
    return np.asarray(_OFFSET_VARIANCE + _product(parts, strengths))


def _product(parts: list[Array], strengths: Strengths) -> Array:
    """The covariance without its offset."""
    product = np.full_like(parts[0], strengths.scale**2)
    for part in parts:
        product *= 1 + part
    return product


def _slopes(parts: list[Array], distances: list[Array], strengths: Strengths) -> list[Array]:
    """Derivatives of the covariance by the logs of the effects, of the scale and of the reach."""
    product = _product(parts, strengths)
    by_effect = [product * part / (1 + part) for part in parts]
    by_reach = np.zeros_like(product)
    for slope, distance in zip(by_effect, distances, strict=True):
        by_reach += slope * np.where(np.isfinite(distance), distance, 0.0) / strengths.reach**2
    return [*by_effect, 2 * product, by_reach]


def _variance(strengths: Strengths) -> float:
    """The covariance of a configuration with itself, before anything is measured."""
    return _OFFSET_VARIANCE + strengths.scale**2 * float(np.prod(1 + strengths.effects))
