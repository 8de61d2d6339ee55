"""Missing forces without a name: a curve over each covariate, fitted as the effect ``discovered_force``."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import ncx2

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import of_best
from sugiyama_ros.diagnosis.covariates import covariates_of, further_covariates
from sugiyama_ros.diagnosis.screen import FULL, Effort, Screened, screen
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import filtered_states

#: Name of a force without a name among the additions.
FORCE = "discovered_force"
_FIRST = index_of(FORCE, "covariate")
_FORCES = tuple(range(_FIRST + 3, _FIRST + 3 + KNOTS))
# Gains by chance are larger than half a chi-squared variable, because the filter is an approximation. This is the
# largest factor in simulations without effects.
_INFLATION = 2.0
# What only a whole road shows.
_ALONE = ("time", "rear_gap", "rear_approach_rate")
#: The knots lie between these quantiles of a covariate.
INNER = (0.02, 0.98)


@dataclass(frozen=True)
class Discovery:
    """A force over one covariate, given at knots.

    Parameters
    ----------
    covariate : str
        Name of the covariate.
    strength : float
        Largest force minus smallest force [m/s^2].
    p_value : float
        Probability of such a gain by chance, corrected for the number of covariates.
    gain_nats : float
        Gain over the model without the force [nats].
    knots : tuple of float
        Values of the covariate, SI units.
    force : tuple of float
        Force at each knot [m/s^2].
    alike : tuple of str
        Other covariates along which a force predicts about as well.
    ago_s : float
        How long ago the covariate had these values [s].
    tests : int
        Number of curves that were tried.
    """

    covariate: str
    strength: float
    p_value: float
    gain_nats: float
    knots: tuple[float, ...]
    force: tuple[float, ...]
    alike: tuple[str, ...] = ()
    ago_s: float = 0.0
    tests: int = len(COVARIATES)

    @property
    def can_be_added(self) -> str:
        """Name by which a force like it can be added to the model; empty if the model cannot have one."""
        if self.covariate in COVARIATES and not self.ago_s:
            return f"{FORCE}:{self.covariate}"
        return next((f"{FORCE}:{name}" for name in self.alike if name in COVARIATES), "")

    @property
    def shown(self) -> str:
        """What the force depends on, in words."""
        when = f" ({self.ago_s:g} s ago)" if self.ago_s else ""
        return " or ".join((f"{self.covariate}{when}", *self.alike))


def discover(
    data: Recorded, fitted: JointFit, work: Executor, effort: Effort = FULL, only: Sequence[str] = COVARIATES
) -> Iterator[tuple[Discovery, Screened]]:
    """Fit a force over each covariate, one after the other.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model without the force.
    work : Executor
        Runs the filters.
    effort : Effort
        Limits of the fits.
    only : sequence of str
        Names of the covariates.

    Yields
    ------
    (Discovery, Screened)
        A force with its rough fit. The p-value is corrected for the number of forces.
    """
    states = filtered_states(data, fitted.model, work)
    seen = covariates_of(data, states)
    seen |= further_covariates(data, states, seen)
    around = data.vicinity
    unknown = () if around.is_whole_road else _ALONE + ("place",) * (not around.has_places)
    for number, covariate in enumerate(COVARIATES, 1):
        if covariate in unknown or covariate not in only:
            continue
        road = around.road
        if covariate == "place":
            low, high = 0.0, road.circumference_m
            if not road.is_ring:
                low, high = (float(q) for q in np.nanquantile(around.position_m, INNER))
        elif covariate == "time":
            low, high = around.first_last_s
        elif covariate == "leader_acceleration":
            low, high = -3.0, 3.0
        else:
            values = seen[covariate]
            values = values[np.isfinite(values)]
            if len(values) < 100:
                continue
            low, high = (float(q) for q in np.quantile(values, INNER))
        start: dict[int, float | Array] = {_FIRST: float(number), _FIRST + 1: low, _FIRST + 2: high}
        look = screen(data, fitted, Candidate(FORCE, "effect", _FORCES, (start,)), work, effort)
        force = look.fit.model.rows[0, list(_FORCES)]
        ring = covariate == "place" and road.is_ring
        knots = low + (high - low) * np.arange(KNOTS) / (KNOTS if ring else KNOTS - 1)
        discovery = Discovery(
            covariate=covariate,
            strength=float(np.ptp(force)),
            p_value=p_value_of_force(look.gain, KNOTS - 1, len(COVARIATES)),
            gain_nats=look.gain,
            knots=tuple(knots.tolist()),
            force=tuple(force.tolist()),
        )
        yield discovery, look


def is_force(name: str) -> bool:
    """Return whether a name asks for a force without a name: ``discovered_force`` or ``discovered_force:COVARIATE``."""
    return name == FORCE or name.startswith(f"{FORCE}:")


def best_force(
    data: Recorded, fitted: JointFit, work: Executor, effort: Effort, name: str
) -> tuple[Discovery, Screened]:
    """Return the force without a name that gains most, or the one along the covariate that the name gives.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model without the force.
    work : Executor
        Runs the filters.
    effort : Effort
        Limits of the fits.
    name : str
        ``discovered_force``, or ``discovered_force:COVARIATE``.

    Returns
    -------
    (Discovery, Screened)
        The force with its rough fit.

    Raises
    ------
    InputError
        For a covariate that is not known, or that the recording does not show.
    """
    covariate = name.partition(":")[2]
    found = list(discover(data, fitted, work, effort, [covariate] if covariate else COVARIATES))
    if not found:
        raise InputError(f"{name}: this recording does not show that covariate; give one of {', '.join(COVARIATES)}")
    return max(found, key=lambda one: one[0].gain_nats)


def against_simulations(
    found: Sequence[tuple[Discovery, Screened]],
    simulations: Sequence[tuple[Recorded, JointFit]],
    work: Executor,
    effort: Effort,
) -> list[tuple[Discovery, Screened]]:
    """Compare forces with the forces that are found in recordings that the model simulates.

    The filter approximates, so that a force gains something even where none is missing, the more the smaller the noise.

    Parameters
    ----------
    found : sequence of (Discovery, Screened)
        Forces with their rough fits.
    simulations : sequence of (Recorded, JointFit)
        Simulated recordings, with the fits to them.
    work : Executor
        Runs the filters.
    effort : Effort
        Limits of the fits.

    Returns
    -------
    list of (Discovery, Screened)
        The same forces. Their p-values come from a non-central chi-squared distribution, with the mean of the simulated
        gains if that is larger than by chance alone.
    """
    names = [force.covariate for force, _ in found]
    gains: dict[str, list[float]] = {name: [] for name in names}
    for simulated, fitted in simulations:
        for force, _ in discover(simulated, fitted, work, effort, names):
            gains[force.covariate].append(force.gain_nats)
    return [(against(force, gains[force.covariate]), look) for force, look in found]


def against(force: Discovery, simulated: Sequence[float]) -> Discovery:
    """Return a force with its probability by chance, given its gains [nats] in recordings that the model simulates."""
    free = len(force.knots) - 1
    return replace(force, p_value=p_value_of_force(force.gain_nats, free, force.tests, simulated))


def p_value_of_force(gain: float, free: int, tests: int, simulated: Sequence[float] = ()) -> float:
    """Return the probability of a gain without a force.

    Parameters
    ----------
    gain : float
        Gain [nats].
    free : int
        Number of free parameters.
    tests : int
        Number of forces that were tried.
    simulated : sequence of float
        Gains [nats] in recordings that the model simulates.

    Returns
    -------
    float
        Probability from a chi-squared distribution, which is non-central if the simulated gains are larger than by
        chance.
    """
    beyond = max(2.0 * float(np.mean(simulated)) / _INFLATION - free, 0.0) if len(simulated) else 0.0
    return of_best(float(ncx2.sf(2.0 * max(gain, 0.0) / _INFLATION, free, beyond)), tests)
