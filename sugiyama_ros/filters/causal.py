"""The strictly causal filter: drivers act on the filtered states of themselves and of the vehicles ahead.

The paper takes what a driver perceives from smoothed measurements, which know the future, as a given control. Here the
mean action is a function of the filtered state and enters the covariance, so that an innovation depends on the past
alone. A driver is filtered together with a chain of vehicles ahead,

    own -> leader -> ... -> last.

Each but the last drives by the paper's model (Eq. ssm_form) behind the next. The last moves with an AR(1) acceleration,
because its leader is not known; so does a leader behind whom the chain has nobody else. For a driver the state is
(position, speed, noise, held). The noise n_t = rho n_{t-1} + shock is the acceleration beyond what the driver means and
the environment adds. The held acceleration is what the driver made the car do in the last period (the mean action,
except for effects). For the last vehicle the noise is the whole acceleration. Parameters that are adapted online follow
as logarithms that wander around their prior (Ornstein-Uhlenbeck), so that a parameter that the data do not determine
stays near its prior.

``linearisation`` states the model; this module filters recordings with it (``causal_kernel`` is its loop), and
``online`` filters sample by sample.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import at_period
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.causal_kernel import Observed, Predicted, Trace, run
from sugiyama_ros.filters.chain import NOT_ADAPTED, Adaptation, Chain, adaptation_of, chain_parameters
from sugiyama_ros.filters.past import periods_back
from sugiyama_ros.filters.state import STATE, drivers_at, scene_at
from sugiyama_ros.filters.vectors import ABREAST

# Arrays of a chain, in the order of ``Observed``.
_MEASURED = ("position_m", "identity", "length_m", "rear")


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the causal filter says of one driver over T samples, after the update with each.

    innovation_m, innovation_var: (T,), NaN where nothing was predicted or measured; sample_log_likelihood: (T,), NaN
    where a sample does not count; mean: (T, 4 M + A), covariance: (T, 4 M + A, 4 M + A) of the chain's state and the
    adapted log parameters; acceleration, mean_action: (T,) [m/s^2] own. The own position is continuous, not wrapped.
    """

    innovation_m: Array
    innovation_var: Array
    sample_log_likelihood: Array
    mean: Array
    covariance: Array
    acceleration: Array
    mean_action: Array
    log_likelihood: float

    @property
    def scored(self) -> NDArray[np.bool_]:
        """(T,): whether a sample counts."""
        return np.isfinite(self.sample_log_likelihood)


def filter_chain(
    chain: Chain, parameters: Array, adaptation: Adaptation = NOT_ADAPTED, ahead: Array | None = None
) -> Filtered:
    """Filter one driver's chain.

    ahead: parameters of the drivers ahead, as for ``chain_parameters``.
    """
    samples, vehicles = chain.position_m.shape
    size = STATE * vehicles + len(adaptation_of(parameters, adaptation).names)
    trace = Trace(np.empty((1, samples, size)), np.empty((1, samples, size, size)), np.empty((1, samples, 2)))
    job, adapted = ChainJob(chain, parameters, ahead), adaptation_of(parameters, adaptation)
    predicted = _run([job], adapted, trace, np.array([samples]))
    motion, total = trace.motion[0], float(np.nansum(predicted.log_likelihood))
    return Filtered(*_first(predicted), trace.means[0], trace.covariances[0], motion[:, 0], motion[:, 1], total)


def filter_each(jobs: Sequence["ChainJob"]) -> Iterator[tuple[int, Filtered]]:
    """Yield the number of each job and what the filter says of its driver; filters run side by side where they can."""
    for numbers, adaptation in _side_by_side(jobs):
        some = [jobs[i] for i in numbers]
        samples = max(len(job.chain.position_m) for job in some)
        size = STATE * some[0].chain.position_m.shape[1] + len(adaptation.names)
        shapes = ((size,), (size, size), (2,))
        trace = Trace(*(np.zeros((len(some), samples, *shape)) for shape in shapes))
        predicted = _run(some, adaptation, trace, np.array([job.chain.end for job in some]))
        for k, (i, job) in enumerate(zip(numbers, some, strict=True)):
            last = len(job.chain.position_m)
            found = Predicted(*(values[k, :last] for values in predicted))
            means, covariances, motion = (values[k, :last] for values in trace)
            total = float(np.nansum(found.log_likelihood))
            yield i, Filtered(*found, means, covariances, motion[:, 0], motion[:, 1], total)


class ChainJob(NamedTuple):
    """One driver to filter: the chain, the driver's parameters and those of the drivers ahead, as ``filter_chain``.

    is_rough: whether the mean actions have single precision, which takes three quarters of the time.
    """

    chain: Chain
    parameters: Array
    ahead: Array | None = None
    is_rough: bool = False


def predict_samples(jobs: Sequence[ChainJob]) -> list[Predicted]:
    """Return how well each sample is predicted.

    Filters run side by side where they can, which takes less time than one after the other, with the same results.
    """
    return [predicted for predicted, _ in _filtered(jobs, with_states=False)]


def predict_states(jobs: Sequence[ChainJob]) -> list[tuple[Array, Array, Array, Array]]:
    """Return how well each sample of some drivers is predicted, and the states of their chains."""
    return [(*predicted, states) for predicted, states in _filtered(jobs, with_states=True)]


def _filtered(jobs: Sequence[ChainJob], *, with_states: bool) -> list[tuple[Predicted, Array]]:
    """Filter drivers, side by side where they can; the predictions and the states (T, STATE M + A), or nothing."""
    found: dict[int, tuple[Predicted, Array]] = {}
    for numbers, adaptation in _side_by_side(jobs):
        some = [jobs[i] for i in numbers]
        chains = [job.chain for job in some]
        samples, vehicles = max(len(c.position_m) for c in chains), chains[0].position_m.shape[1]
        kept = len(numbers) if with_states else 0
        means = np.zeros((kept, samples, STATE * vehicles + len(adaptation.names)))
        ends = np.array([chain.end for chain in chains])
        predicted = _run(some, adaptation, _no_trace()._replace(means=means), ends)
        for k, (i, chain) in enumerate(zip(numbers, chains, strict=True)):
            last = len(chain.position_m)
            states = means[k, :last].copy() if with_states else np.empty((0, 0))
            found[i] = Predicted(*(values[k, :last] for values in predicted)), states
    return [found[i] for i in range(len(jobs))]


def log_likelihood(chain: Chain, parameters: Array, ahead: Array | None = None) -> float:
    """Return the log-likelihood of one driver's chain, Eq. SSM_Likelihood without the term of 2 pi.

    Arguments as for ``filter_chain``.
    """
    return float(np.nansum(predict_samples([ChainJob(chain, parameters, ahead)])[0].log_likelihood))


def _side_by_side(jobs: Sequence[ChainJob]) -> Iterator[tuple[list[int], Adaptation]]:
    """Yield the numbers of jobs that can run side by side, a few at a time, and what adapts in their filters.

    Jobs of similar length run together, so that few lanes stay empty at the end.
    """
    groups: dict[Any, list[int]] = defaultdict(list)
    for i, (chain, parameters, _, is_rough) in enumerate(jobs):
        same = (chain.position_m.shape[1], chain.period_s, chain.circumference_m, is_rough, adaptation_of(parameters))
        groups[same].append(i)
    for (*_, adaptation), numbers in groups.items():
        numbers.sort(key=lambda i: len(jobs[i].chain.position_m))
        for first in range(0, len(numbers), ABREAST):
            yield numbers[first : first + ABREAST], adaptation


def _first(predicted: Predicted) -> Predicted:
    return Predicted(*(values[0] for values in predicted))


def _no_trace() -> Trace:
    return Trace(np.empty((0, 0, 0)), np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)))


def _run(jobs: Sequence[ChainJob], adaptation: Adaptation, trace: Trace, ends: Ints) -> Predicted:
    """Run the compiled filter with fresh arrays, up to ``ends`` (C,) samples; returns the predictions, (C, T) each."""
    chains, one = [job.chain for job in jobs], jobs[0].chain
    vehicles = one.position_m.shape[1]
    rows = at_period(np.array([chain_parameters(j.parameters, j.ahead, vehicles) for j in jobs]), one.period_s)
    samples = max(len(chain.position_m) for chain in chains)
    predicted = Predicted(*(np.full((len(jobs), samples), np.nan) for _ in range(3)))
    start_s = np.array([chain.start_s for chain in chains])
    position, identity, length, rear = (_stacked([getattr(chain, name) for chain in chains]) for name in _MEASURED)
    run(
        Observed(position, identity, length, rear, start_s, ends),
        drivers_at(rows, *adaptation.arrays),
        ACTIONS,
        jobs[0].is_rough,
        scene_at(one.period_s, one.circumference_m, adaptation.relaxation_s),
        periods_back(rows, one.period_s),
        predicted,
        trace,
    )
    return predicted


def _stacked(arrays: Sequence[Any]) -> Any:
    """Stack arrays along a new first axis, always as a new array: views would be compiled anew.

    Shorter arrays are filled up with zeros, which nobody reads.
    """
    lengths = {len(one) for one in arrays}
    if len(lengths) == 1:
        return np.array(arrays)
    stacked = np.zeros((len(arrays), max(lengths), *arrays[0].shape[1:]), dtype=arrays[0].dtype)
    for row, one in zip(stacked, arrays, strict=True):
        row[: len(one)] = one
    return stacked
