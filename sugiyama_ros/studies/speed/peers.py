"""The paper's calibration by other means: filterpy with numpy, and statsmodels.

The recipe with filterpy is a Kalman filter in a Python loop, with the mean action in numpy and scipy's L-BFGS-B with
difference quotients. statsmodels has a compiled filter and its own search, and gets the same matrices.
"""

from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_functions
from sugiyama_ros.studies.speed.filterpy_recipe import PLACES, plain_fit, plain_likelihood, start_parameters
from sugiyama_ros.studies.speed.floors import DRIVER
from sugiyama_ros.studies.speed.recording import jam
from sugiyama_ros.studies.speed.statsmodels_recipe import StatsmodelsDriver

_HOPS = 100
# Largest difference of two log-likelihoods that are the same function [nats].
_ALIKE = 1e-6


def measure() -> tuple[SpeedFigure, ...]:
    """Measure likelihoods and searches of one driver by other means, over ours of the same driver.

    Raises RuntimeError.
    """
    t = jam()
    perceived, p = paper.perceive(t, DRIVER), defaults()
    other = StatsmodelsDriver(perceived)
    start = start_parameters()
    check("filterpy", plain_likelihood(perceived, p), paper.log_likelihood(perceived, p)[0])
    check(
        "statsmodels",
        other.without_2_pi(other.loglike(other.start_params)),
        paper.log_likelihood(perceived, start)[0],
    )
    others = [v for v in t.vehicle.tolist() if v != t.vehicle[DRIVER]]
    one = cpu_of_functions(
        {
            "ours": lambda: paper.score(perceived, p, PLACES),
            "filterpy": lambda: plain_likelihood(perceived, p),
            "statsmodels": lambda: other.loglike(other.start_params),
        },
        rounds=5,
    )
    fit = cpu_of_functions(
        {
            "ours": lambda: list(calibrate(t, "paper", skip=others)),
            "filterpy": lambda: plain_fit(perceived),
            "statsmodels": lambda: other.fit(method="lbfgs", optim_complex_step=False, cov_type="none", disp=False),
        },
        rounds=2,
    )
    ours = "over ours with gradient and information"
    by_filterpy, by_statsmodels = fit["filterpy"] / fit["ours"], fit["statsmodels"] / fit["ours"]
    return (
        SpeedFigure("filterpy_likelihood", f"likelihood by filterpy and numpy {ours}", one["filterpy"] / one["ours"]),
        SpeedFigure("statsmodels_likelihood", f"likelihood by statsmodels {ours}", one["statsmodels"] / one["ours"]),
        SpeedFigure("filterpy_fit", "search of one driver by filterpy, numpy and L-BFGS-B over ours", by_filterpy),
        SpeedFigure("statsmodels_fit", "search of one driver by statsmodels and its L-BFGS over ours", by_statsmodels),
        SpeedFigure(
            "basinhopping_fit",
            f"basinhopping with {_HOPS} such searches by filterpy, extrapolated",
            _HOPS * by_filterpy,
        ),
    )


def check(who: str, theirs: float, ours: float) -> None:
    """Raise RuntimeError if two log-likelihoods [nats] differ.

    who: whose log-likelihood ``theirs`` is; theirs, ours: log-likelihoods [nats].
    """
    if not abs(theirs - ours) < _ALIKE:
        raise RuntimeError(f"the log-likelihood of {who} is {theirs - ours:g} nats above ours")
