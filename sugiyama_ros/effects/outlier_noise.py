"""Now and then a measurement is far off."""

import math

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, Effect, at
from sugiyama_ros.road import Array


@njit(cache=True)
def weigh(innovation: float, variance: float, noise_var: float, p: Array) -> tuple[float, float, float]:
    """Probability that a sample is an outlier, the variance of its innovation then, and its log-likelihood.

    A share ``p[0]`` of all samples has ``p[1]`` times the noise's std (Tukey's contaminated normal distribution).
    """
    wide = variance + (p[1] * p[1] - 1.0) * noise_var
    good = (1.0 - p[0]) * math.exp(-0.5 * innovation * innovation / variance) / math.sqrt(variance)
    bad = p[0] * math.exp(-0.5 * innovation * innovation / wide) / math.sqrt(wide) + 1e-300
    return bad / (good + bad), wide, math.log(good + bad)


EFFECT = Effect(
    name="outlier_noise",
    stage=MEASUREMENT,
    summary="a share of the measurements is far off (heavy tails)",
    source="Tukey, in Contributions to Probability and Statistics (1960) 448",
    parameters=(
        Parameter("share", "ε", "1", 0.0, 0.0, 0.6, "share of outliers"),
        Parameter("factor", "k", "1", 0.0, 1.2, 50.0, "their std over that of the other measurements"),
    ),
    starts=at({"share": 0.05, "factor": 3.0}, {"share": 0.005, "factor": 5.0}),
)
