"""Tukey's contaminated normal distribution: most measurements are good, a few are much worse."""

import math

from sugiyama_ros.jit import kernel


@kernel
def contaminated_normal(
    innovation: float, variance: float, noise_var: float, share: float, factor: float
) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements.

    innovation: measured minus predicted position [m]; variance: variance [m^2] of the innovation of a good measurement;
    noise_var: variance [m^2] of the noise of a good measurement. Returns probability that the sample is bad, variance
    [m^2] of the innovation of a bad sample, and log-likelihood of the sample.

    References
    ----------
    Tukey, in Contributions to Probability and Statistics (1960) 448.
    """
    wide = variance + (factor * factor - 1.0) * noise_var
    good = (1.0 - share) * math.exp(-0.5 * innovation * innovation / variance) / math.sqrt(variance)
    bad = share * math.exp(-0.5 * innovation * innovation / wide) / math.sqrt(wide) + 1e-300
    return bad / (good + bad), wide, math.log(good + bad)
