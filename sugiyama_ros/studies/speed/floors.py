"""The two likelihoods, compared with the exponentials that they cannot do without."""

from collections.abc import Callable

import numpy as np

from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.driver.utility import ACTIONS, FORWARD
from sugiyama_ros.filters import causal, paper
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_functions
from sugiyama_ros.studies.speed.recording import jam
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Column of the driver whose likelihoods are measured.
DRIVER = 3
_ROUNDS = 40
# Drivers whose causal likelihoods are computed together, as fits do; the time is the mean.
_TOGETHER = 4
_PLACES = [NAMES.index(name) for name in ESTIMATED]


def exponentials(perceived: paper.Perceived) -> Callable[[], object]:
    """Make a function that computes the exponentials of one likelihood in one call of numpy: the floor.

    Each action takes three exponentials at each moment: two for the utility and one for the weight. An action that
    ends at a low speed takes a fourth exponential.
    """
    slow = perceived.speed[:, None] + perceived.period_s * ACTIONS < FORWARD
    x = -np.random.default_rng(0).uniform(0.0, 10.0, 3 * slow.size + int(slow.sum()))
    out = np.empty_like(x)
    return lambda: np.exp(x, out=out)


def likelihoods(t: Trajectories, rounds: int) -> dict[str, float]:
    """Measure one likelihood of a driver in both formulations, and the floor.

    Returns CPU times [s] of ``floor``, ``paper`` (with its gradient and information) and ``causal``.
    """
    perceived, p = paper.perceive(t, DRIVER), defaults()
    jobs = [causal.ChainJob(chain_behind(t, DRIVER + k), p) for k in range(_TOGETHER)]
    functions: dict[str, Callable[[], object]] = {
        "floor": exponentials(perceived),
        "paper": lambda: paper.score(perceived, p, _PLACES),
        "causal": lambda: causal.predict_samples(jobs),
    }
    spent = cpu_of_functions(functions, rounds)
    return spent | {"causal": spent["causal"] / _TOGETHER}


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the floor and the two likelihoods."""
    t = jam()
    spent = likelihoods(t, _ROUNDS)
    floor, step = spent["floor"], 1e6 / len(t.position_m)
    return (
        SpeedFigure("floor_ms", "exponentials of one likelihood, in one call of numpy: the floor", 1e3 * floor, "ms"),
        SpeedFigure(
            "paper_likelihood_over_floor",
            "one likelihood in the paper's form, with gradient and information, over the floor",
            spent["paper"] / floor,
        ),
        SpeedFigure("filter_pass_over_floor", "one pass of the causal filter over the floor", spent["causal"] / floor),
        SpeedFigure(
            "filter_pass_us", "one pass of the causal filter, for each driver and step", step * spent["causal"], "µs"
        ),
    )
