"""Whether calibrated drivers are sound: does the filter know its own errors, or has it diverged?"""

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.result import Calibration
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import ChainJob, predict_samples
from sugiyama_ros.filters.extract import chain_behind

# Mean NIS within which a filter knows its own errors well enough; 1 is right.
_LEAST_NIS, _LARGEST_NIS = 0.5, 2.0
# Part of the samples without a leader from which a vehicle follows nobody.
_ALONE = 0.9
# One-step error [m] beyond which the filter has lost the vehicle.
_LARGEST_ERROR_M = 1000.0


def mean_nis(calibration: Calibration) -> Array:
    """Mean of the squared normalised innovations of each driver in the causal filter, (N,). Raises InputError.

    It is 1 for a filter that knows its own errors, and NaN for a driver without a scored sample.
    """
    t, found = calibration.road, []
    if t is None:
        return np.array([driver.nis for driver in calibration.drivers])
    jobs = [ChainJob(chain_behind(t, i), row) for i, row in enumerate(calibration.rows)]
    for i, predicted in enumerate(predict_samples(jobs)):
        scored = np.isfinite(predicted.innovation) & np.isfinite(predicted.log_likelihood)
        y, variance = predicted.innovation[scored], predicted.innovation_var[scored]
        largest = float(np.nanmax(np.abs(predicted.innovation), initial=0.0))
        if np.isnan(calibration.log_likelihood[i]) or largest > _LARGEST_ERROR_M:
            raise InputError(
                f"{t.source}: vehicle {t.name[i]}: the filter has lost it (one-step error beyond 1 km); check its"
                " positions, and give --ring METRES if the road is a ring"
            )
        found.append(float(np.mean(np.square(y) / variance)) if len(y) else float("nan"))
    return np.array(found)


def cautions(calibration: Calibration) -> list[str]:
    """Say in one line each what makes the figures of a calibration doubtful. Raises InputError as ``mean_nis``."""
    desired = _desired_speeds(calibration)
    t = calibration.road
    if t is None or calibration.settings.formulation == "paper":
        return desired
    nis, vehicles = mean_nis(calibration), np.array([driver.shown for driver in calibration.drivers])
    lines: list[str] = []
    small, large = nis < _LEAST_NIS, nis > _LARGEST_NIS
    if small.any():
        lines.append(
            f"{_named(vehicles[small])}: mean NIS {np.median(nis[small]):.2f} instead of 1: the positions are smoother"
            " than the model's noise, so that the standard errors are too large; estimate sigma_x and sigma_v too"
            " (--parameters sigma_nu,sigma_a,v_star,kappa_v,sigma_x,sigma_v)"
        )
    if large.any():
        lines.append(
            f"{_named(vehicles[large])}: mean NIS {np.median(nis[large]):.2f} instead of 1: the model does not fit, and"
            " the standard errors are too small; `sugiyama diagnose` looks for what is missing"
        )
    if (unknown := np.isnan(nis)).any():
        lines.append(f"{_named(vehicles[unknown])}: too few samples, so that no parameter is known")
    alone = np.mean(t.leader < 0, axis=0) > _ALONE
    if alone.any():
        follow = "follow" if alone.sum() > 1 else "follows"
        lines.append(
            f"{_named(vehicles[alone])}: {follow} nobody: v_star holds only if the road ahead was free, and kappa_v is"
            " not known"
        )
    return lines + (desired if not unknown.all() else [])


def _desired_speeds(calibration: Calibration) -> list[str]:
    """Say that the desired speed of most drivers has no value; empty if it has one."""
    if "v_star" not in calibration.settings.estimated:
        return []
    known = calibration.has_value("v_star")
    if 2 * known.sum() >= len(known):
        return []
    return [
        f"v_star is not identified for {(~known).sum()} of {len(known)} drivers: the recording does not say how fast"
        " they want to drive; record them in faster traffic, too"
    ]


def _named(vehicles: NDArray[np.str_]) -> str:
    shown = ", ".join(str(v) for v in vehicles[:5])
    return f"vehicle{'s' if len(vehicles) > 1 else ''} {shown}" + (", ..." if len(vehicles) > 5 else "")
