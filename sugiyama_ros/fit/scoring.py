"""Damped Fisher scoring: the one optimiser of all fits.

The expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2), which is positive, so
Newton's step with it climbs. Levenberg and Marquardt's damping shortens a step that does not. ``search`` serves a
single driver; ``fit.joint`` and ``fit.classes`` take the same step under the same rules for many.

References
----------
Marquardt, J. SIAM 11 (1963) 431. Osborne, Fisher's method of scoring, Int. Stat. Rev. 60 (1992) 99.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.fit.bounds import LogSpace

#: Longest step in a logarithm.
LONGEST = 0.7
# Steps of a search at most.
_STEPS = 60


@dataclass(frozen=True)
class Damping:
    """How the damping of a search changes: ten times less after a success, ten times more after a failure.

    start: where it begins; least: lowest value after a success; least_after_failure: lowest value after a failure;
    most: the search ends beyond this value.
    """

    least: float
    least_after_failure: float
    most: float
    start: float = 1e-3

    def updated(self, damping: Any, better: Any, worse: Any) -> Any:
        """The damping (...) after a step that was better, worse, or neither (not tried), (...) each."""
        eased = np.maximum(damping / 10.0, self.least)
        raised = np.maximum(10.0 * damping, self.least_after_failure)
        return np.where(better, eased, np.where(worse, raised, damping))


#: Of the search for a single driver's parameters.
_ALONE = Damping(least=1e-9, least_after_failure=1e-2, most=1e8)


def damped(information: Array, relative: Any, absolute: float = 0.0) -> Array:
    """Information (..., K, K) with a ridge: its diagonal times ``relative`` (...), plus ``absolute``."""
    diagonal = np.arange(information.shape[-1])
    ridge = np.zeros_like(information)
    size = np.abs(information[..., diagonal, diagonal])
    ridge[..., diagonal, diagonal] = np.asarray(relative)[..., None] * size + absolute
    return np.asarray(information + ridge)


def damped_step(information: Array, gradient: Array, relative: float, absolute: float) -> Array:
    """Newton's step (K,) from a gradient (K,) with damped information (K, K)."""
    return np.asarray(np.linalg.solve(damped(information, relative, absolute), gradient), np.float64)


def limited(change: Array, longest: Any) -> Array:
    """A step (...) of which no entry is longer than ``longest``."""
    return np.asarray(np.clip(change, -longest, longest))


class Point(NamedTuple):
    """Where a search stands: coordinates x (K,), the value there, its gradient (K,) and information (K, K) by x.

    scored: what the caller wants to keep of the point.
    """

    x: Array
    value: float
    gradient: Array
    information: Array
    scored: Any


def search(at: Callable[[Array, Point | None], Point], space: LogSpace, enough: float) -> Point:
    """Maximise a function of one driver's parameters.

    Parameters
    ----------
    at
        The point at coordinates (K,), given a point near by if there is one.
    space
        Coordinates, their start and their bounds.
    enough
        The search ends when a step is predicted to gain less than this.

    Returns
    -------
    The best point found.
    """
    here, damping = at(space.x, None), _ALONE.start
    for _ in range(_STEPS):
        x, gradient = here.x, here.gradient
        free = ~(((x <= space.smallest) & (gradient < 0.0)) | ((x >= space.largest) & (gradient > 0.0)))
        if not free.any():
            break
        change = np.zeros_like(x)
        change[free] = damped_step(here.information[np.ix_(free, free)], gradient[free], damping, 1e-9)
        if 0.5 * float(gradient @ change) < enough or damping > _ALONE.most:
            break
        there = at(np.clip(x + limited(change, LONGEST), space.smallest, space.largest), here)
        is_better = there.value > here.value
        here = there if is_better else here
        damping = float(_ALONE.updated(damping, is_better, not is_better))
    return here
