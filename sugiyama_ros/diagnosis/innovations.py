"""Whether the innovations of a model look as they do in recordings that the model simulates: their spread, and in time.

A filter whose model is right has innovations of the variance that it predicts, without correlation in time. A filter
that approximates nearly does, so its own simulations say what to expect.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.fit.recording import Recorded

#: Probability below which innovations are correlated by more than chance.
LEVEL_OF_CORRELATION = 0.01
# Mean NIS of held-out samples, over that of the model's own simulations, within which a filter knows its own errors.
_NIS = (0.8, 1.25)
# Lags, in samples in which somebody is measured, whose correlations count.
_LAGS = (1, 2, 4, 8, 16, 32)
# A correlation is known from more pairs than this.
_FEWEST = 64


def spread_says(final: HeldOutErrors, own: Sequence[HeldOutErrors]) -> list[str]:
    """Say whether the innovations are spread otherwise than in the model's own simulations.

    Gross errors of measurement make the mean NIS larger than 1 although the filter expects them.

    Parameters
    ----------
    final : HeldOutErrors
        Held-out errors of the model.
    own : sequence of HeldOutErrors
        Held-out errors of the model in recordings that it simulates.

    Returns
    -------
    list of str
        At most one reason to doubt the model; empty without simulations.
    """
    if not own:
        return []
    nis, *others = (_mean_square(one) for one in (final, *own))
    expected = float(np.mean(others))
    if _NIS[0] <= nis / expected <= _NIS[1]:
        return []
    surer = "surer" if nis > expected else "less sure"
    return [f"the filter is {surer} of itself than it should be: mean NIS {nis:.2f} instead of {expected:.2f}"]


def correlation_says(final: HeldOutErrors, own: Sequence[HeldOutErrors], data: Recorded) -> list[str]:
    """Say whether the innovations are correlated in time otherwise than in the model's own simulations.

    Parameters
    ----------
    final : HeldOutErrors
        Held-out errors of the model.
    own : sequence of HeldOutErrors
        Held-out errors of the model in recordings that it simulates.
    data : Recorded
        The recording.

    Returns
    -------
    list of str
        At most one reason to doubt the model; empty without simulations.

    References
    ----------
    Box and Pierce, J. Am. Stat. Assoc. 65 (1970) 1509.
    """
    if not own:
        return []
    found, error = _correlations(final, data.every)
    expected = np.mean([_correlations(one, data.every)[0] for one in own], axis=0)
    off = (found - expected) / (error * np.sqrt(1.0 + 1.0 / len(own)))
    off = off[np.isfinite(off)]
    if not len(off) or chi2.sf(float(np.sum(off**2)), len(off)) >= LEVEL_OF_CORRELATION:
        return []
    worst = int(np.nanargmax(np.abs(found - expected) / error))
    apart_s = _LAGS[worst] * data.apart_s
    return [
        f"innovations {apart_s:.2g} s apart are correlated by {found[worst]:.2f} ± {error[worst]:.2f}"
        f" ({expected[worst]:.2f} in its own simulations)"
    ]


def _normal(errors: HeldOutErrors) -> Array:
    """Innovations over their std (N, T), NaN where a sample does not count."""
    samples = errors.samples
    normal: Array = samples.innovation_m / np.sqrt(samples.innovation_var)
    return np.where(np.isfinite(samples.log_likelihood), normal, np.nan)


def _mean_square(errors: HeldOutErrors) -> float:
    """Mean NIS; 1 where no sample counts."""
    normal = _normal(errors)
    return float(np.nanmean(normal**2)) if np.isfinite(normal).any() else 1.0


def _correlations(errors: HeldOutErrors, every: int) -> tuple[Array, Array]:
    """Correlation of innovations at each lag, over all drivers, and its standard error, (L,) each; NaN with few pairs.

    every: vehicles are measured in one sample of so many. The error is that of white noise, or that over the
    drivers where it is larger.
    """
    normal = _normal(errors)[:, ::every]
    means, stds = np.full((2, len(_LAGS)), np.nan)
    for k, lag in enumerate(_LAGS):
        pairs = normal[:, lag:] * normal[:, :-lag]
        known = np.isfinite(pairs)
        sums, counts = np.where(known, pairs, 0.0).sum(axis=1), known.sum(axis=1)
        total = counts.sum()
        if total > _FEWEST:
            means[k] = sums.sum() / total
            stds[k] = max(float(np.sqrt(np.square(sums - means[k] * counts).sum())) / total, 1.0 / np.sqrt(total))
    return means / _mean_square(errors), stds
