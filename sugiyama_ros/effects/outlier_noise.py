"""A few measurements are far off."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, Contamination, Effect, at
from sugiyama_ros.effects.shared import contaminated_normal
from sugiyama_ros.jit import kernel


@kernel
def _weigh(innovation: float, variance: float, noise_var: float, p: Array) -> tuple[float, float, float]:
    """Compute the probability of an outlier, the variance of an outlier's innovation, and the log-likelihood."""
    return contaminated_normal(innovation, variance, noise_var, p[0], p[1])


def _sample(noise: Array, values: Array, rng: np.random.Generator) -> Array:
    """Draw which samples are outliers, and multiply their noise [m] by the factor; noise: (N,), values: (N, 2)."""
    share, factor = values.T
    return np.where(rng.random(len(noise)) < share, factor * noise, noise)


EFFECT = Effect(
    name="outlier_noise",
    stage=MEASUREMENT,
    title="gross errors of measurement",
    summary="a share of the measurements is far off (heavy tails)",
    term="sigma_nu -> factor sigma_nu in a share of the measurements",
    source="Tukey, in Contributions to Probability and Statistics (1960) 448",
    parameters=(
        Parameter("share", "ε", "1", 0.0, 0.0, 0.6, "share of outliers"),
        Parameter("factor", "k", "1", 0.0, 1.2, 50.0, "std of an outlier over the std of the other measurements"),
    ),
    starts=at({"share": 0.05, "factor": 3.0}, {"share": 0.005, "factor": 5.0}),
    contamination=Contamination(_weigh, _sample),
    bank={"share": 0.03, "factor": 3.0},
    benchmark=({"share": 0.006, "factor": 4.0}, {"share": 0.002, "factor": 4.0}),
)
