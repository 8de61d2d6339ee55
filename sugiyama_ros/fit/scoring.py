"""Damped Fisher scoring: the one optimiser of all fits.

The expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2). It is positive, so
Newton's step with this information points uphill. The damping of Levenberg and Marquardt shortens a step that does not
gain. ``search`` fits a single driver; ``fit.joint`` and ``fit.classes`` take the same step with the same rules for many
drivers.

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

#: Longest step of a logarithm.
LONGEST = 0.7
# Maximum number of steps of a search.
_STEPS = 60


@dataclass(frozen=True)
class Damping:
    """How the damping of a search changes: it is divided by ten after a success and multiplied by ten after a failure.

    least: smallest value after a success; least_after_failure: smallest value after a failure; most: the search ends
    beyond this value; start: value at the start.
    """

    least: float
    least_after_failure: float
    most: float
    start: float = 1e-3

    def updated(self, damping: Any, better: Any, worse: Any) -> Any:
        """Return the damping after a step.

        damping: (...), damping before the step; better, worse: (...), whether the step gained or failed; neither if no
        step was tried. Returns (...), damping after the step.
        """
        eased = np.maximum(damping / 10.0, self.least)
        raised = np.maximum(10.0 * damping, self.least_after_failure)
        return np.where(better, eased, np.where(worse, raised, damping))


# Damping of the search for the parameters of a single driver.
_ALONE = Damping(least=1e-9, least_after_failure=1e-2, most=1e8)


def damped(information: Array, relative: Any, absolute: float = 0.0) -> Array:
    """Return information (..., K, K) with a ridge: its diagonal times ``relative`` (...), plus ``absolute``."""
    diagonal = np.arange(information.shape[-1])
    ridge = np.zeros_like(information)
    size = np.abs(information[..., diagonal, diagonal])
    ridge[..., diagonal, diagonal] = np.asarray(relative)[..., None] * size + absolute
    return np.asarray(information + ridge)


def damped_step(information: Array, gradient: Array, relative: float, absolute: float) -> Array:
    """Return Newton's step (K,) from a gradient (K,) with damped information (K, K)."""
    return np.asarray(np.linalg.solve(damped(information, relative, absolute), gradient), np.float64)


def limited(change: Array, longest: Any) -> Array:
    """Return a step (...) with every entry limited to plus or minus ``longest``."""
    return np.asarray(np.clip(change, -longest, longest))


class Point(NamedTuple):
    """A point of a search.

    x: (K,), coordinates; value: value of the function; gradient: (K,), gradient by the coordinates; information: (K,
    K), information by the coordinates; scored: what the caller wants to keep with the point.
    """

    x: Array
    value: float
    gradient: Array
    information: Array
    scored: Any


def search(at: Callable[[Array, Point | None], Point | None], space: LogSpace, enough: float) -> Point:
    """Maximise a function of the parameters of one driver."""
    here, damping = at(space.x, None), _ALONE.start
    if here is None:
        raise ValueError("the search needs a point to begin with")
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
        is_better = there is not None and there.value > here.value
        here = there if there is not None and is_better else here
        damping = float(_ALONE.updated(damping, is_better, not is_better))
    return here
