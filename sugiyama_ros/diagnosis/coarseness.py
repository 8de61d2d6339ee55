"""Whether positions are so coarse, in space or in time, that a search may name an effect for it."""

import numpy as np

from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.fit.recording import Recorded

# Part of the innovations' variance from which rounding matters.
_MATTERS = 0.05


def resolution_m(data: Recorded) -> float:
    """Return the smallest distance [m] between two different positions of a recording; 0 for a single position."""
    position = data.vicinity.position_m
    apart = np.diff(np.unique(position[np.isfinite(position)]))
    # what differs by less is the same number, computed in two ways
    apart = apart[apart > 1e-9]
    return float(apart.min()) if apart.size else 0.0


def rounding_says(data: Recorded, final: HeldOutErrors) -> list[str]:
    """Say that rounding is a large part of the errors.

    The filter takes errors of the positions for normal and independent. Those of rounding are neither: a vehicle that
    stands is always off by the same distance.

    Parameters
    ----------
    data : Recorded
        The recording.
    final : HeldOutErrors
        Held-out errors of the final model.

    Returns
    -------
    list of str
        One reason, or none.
    """
    q, variance = resolution_m(data), float(np.nanmedian(final.samples.innovation_var))
    part = q**2 / 12.0 / variance
    if part <= _MATTERS:
        return []
    return [
        f"positions are rounded to {q:.2g} m, {100.0 * part:.0f} % of the variance of the innovations: what is named"
        " may only make up for it"
    ]


def sampling_says(data: Recorded) -> list[str]:
    """Say that samples are so far apart that drivers decide several times in between.

    Close to contact, what a driver does depends on where exactly the leader is. Between two samples the filter knows
    the leader poorly, and its linear forecast goes wrong there.

    Parameters
    ----------
    data : Recorded
        The recording.

    Returns
    -------
    list of str
        One reason, or none.
    """
    if not data.is_sparse:
        return []
    return [
        f"samples are {data.apart_s:.2g} s apart, and drivers decide {data.every} times from one to the next: what is"
        " named may only make up for what the filter cannot know in between"
    ]
