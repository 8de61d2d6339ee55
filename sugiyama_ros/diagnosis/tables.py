"""Tables of a diagnosis and of a comparison."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sugiyama_ros.diagnosis.compare import Compared, Comparison
from sugiyama_ros.diagnosis.diagnosis import Diagnosis
from sugiyama_ros.simulation.collective import Collective
from sugiyama_ros.tables import TextTable

# Heading of each error in a summary.
_ERRORS = {
    "one_step_rmse_m": "one-step [m]",
    "free_run_2s_m": "free run 2 s [m]",
    "free_run_5s_m": "5 s [m]",
    "free_run_10s_m": "10 s [m]",
    "single_car_2s_m": "one car 2 s [m]",
    "single_car_5s_m": "5 s [m]",
    "single_car_10s_m": "10 s [m]",
    "loglik_per_sample": "nats per sample",
}
# Headings of the errors that a comparison shows first.
_MAIN = {
    "one_step_rmse_m": "one-step [m]",
    "free_run_10s_m": "10 s [m]",
    "single_car_10s_m": "one car 10 s [m]",
}
# Errors that get a third decimal place.
_SMALL = ("one_step_rmse_m", "loglik_per_sample")
# Heading and name of each further error.
_DETAILS = {
    "gap [m]": "gap_m",
    "of mean gap [%]": "gap_relative",
    "fit [%]": "gap_fit_percent",
    "speed [m/s]": "speed_mps",
    "time gap [s]": "time_gap_s",
}
# Kinds of free runs, in words.
_RUNS = {"free_run": "coupled", "single_car": "of a single car"}
_COLLECTIVE = ("mean speed [m/s]", "least [m/s]", "largest [m/s]", "wave speed [m/s]", "queue [vehicles]", "period [s]")


def steps(diagnosis: Diagnosis) -> TextTable:
    """Return the held-out errors of the base model, after each addition, and of other laws."""
    models = [("base model", diagnosis.before.summary())]
    models += [(f"+ {added.name}", added.after.summary()) for added in diagnosis.named]
    models += [(_law(name, summary), summary) for name, summary in diagnosis.rivals.items()]
    names = _known([summary for _, summary in models])
    rows = tuple((name, *_error_cells(summary, names)) for name, summary in models)
    title = "Held-out errors, step by step"
    if any("drivers" in summary for _, summary in models):
        title += "; laws that are fitted to some drivers stand with their number"
    return TextTable(title, ("model", *(_ERRORS[name] for name in names)), rows, left=1)


def _law(name: str, summary: Mapping[str, float]) -> str:
    """A law, with the number of drivers to whom it was fitted if there are more in the recording."""
    return f"{name} ({summary['drivers']} drivers)" if "drivers" in summary else name


def by_driver(drivers: Sequence[Mapping[str, Any]]) -> TextTable:
    """Return the gain of the additions for each driver; ``drivers`` as in the document of the diagnosis."""
    headings = ("vehicle", "held-out gain [nats]", "one car 10 s, before [m]", "after [m]")
    rows = tuple(
        (
            f"{d.get('recording', '')} {d.get('name', d['vehicle'])}".strip(),
            f"{d['heldout_gain_nats']:.1f}",
            f"{d['single_car_10s_before_m']:.2f}",
            f"{d['single_car_10s_after_m']:.2f}",
        )
        for d in drivers
    )
    return TextTable("By driver, before and after", headings, rows)


def main_errors(comparison: Comparison) -> TextTable:
    """Return the models to look at first, with what they gain over the base model and their errors after 10 s."""
    shown = comparison.main()
    known = _known([one.errors.summary() for one in shown])
    names = [name for name in _MAIN if name in known]
    rows = []
    for one in shown:
        won = f"{one.gain.nats:.0f} ± {one.gain.se:.0f}" if one.gain else "0"
        rows.append((one.name, won, *_error_cells(one.errors.summary(), names)))
    headings = ("model", "gain [nats]", *(_MAIN[name] for name in names))
    return TextTable(f"{_title(shown)}, the best model first", headings, tuple(rows), left=1)


def _title(shown: Sequence[Compared]) -> str:
    """What the errors of these models are."""
    return "Errors" if any(one.kind == "in_sample" for one in shown) else "Held-out errors"


def held_out_errors(compared: Sequence[Compared]) -> TextTable:
    """Return the held-out errors of each model, its gain over the base model, and statistics of its innovations."""
    rows, names = [], _known([one.errors.summary() for one in compared])
    for one in compared:
        gain = f"{one.gain.nats:.0f} ± {one.gain.se:.0f}" if one.gain else ""
        nis = f"{one.nis_mean:.2f} ± {one.nis_std_error:.2f}"
        rows.append((one.name, *_error_cells(one.errors.summary(), names), gain, nis, f"{one.autocorrelation[0]:+.3f}"))
    headings = ("model", *(_ERRORS[name] for name in names), "gain [nats]", "mean NIS", "autocorr.")
    return TextTable(_title(compared), headings, tuple(rows), left=1)


def details(compared: Sequence[Compared]) -> TextTable:
    """Return errors of gap, speed and time gap after 10 s, in free runs of all cars and of a single car."""
    rows, every = [], [one.errors.details() for one in compared]
    runs = [run for run in _RUNS if any(math.isfinite(figures[f"{run}_10s_gap_m"]) for figures in every)]
    for one, figures in zip(compared, every, strict=True):
        values = [
            figures.get(f"{run}_10s_{name}", math.nan) * (100.0 if name == "gap_relative" else 1.0)
            for run in runs
            for name in _DETAILS.values()
        ]
        rows.append((one.name, *(f"{v:.2f}" if abs(v) < 10.0 else f"{v:.0f}" for v in values)))
    title = f"{_title(compared)} of 10-s free runs: " + ", and ".join(_RUNS[run] for run in runs)
    return TextTable(title, ("model", *[*_DETAILS] * len(runs)), tuple(rows), left=1)


def collective(measured: Collective, wave_speed_se: float, compared: Sequence[Compared]) -> TextTable:
    """Return collective measures of the recording and of simulations of each model, with standard deviations.

    The measured speed of waves has its standard error, over blocks of time.
    """
    errors = {"wave_speed": wave_speed_se}
    rows = [("measured", *(_with_std(v, errors.get(name, math.nan)) for name, v in asdict(measured).items()))]
    rows += [
        (one.name, *(_with_std(mean, std) for mean, std in one.collective.values()))
        for one in compared
        if one.collective
    ]
    return TextTable("Collective measures: recorded and simulated", ("", *_COLLECTIVE), tuple(rows), left=1)


def _known(summaries: Sequence[Mapping[str, float]]) -> list[str]:
    """Names of the errors that at least one model has: tracks have no coupled runs."""
    return [name for name in _ERRORS if any(math.isfinite(one[name]) for one in summaries)]


def _with_std(mean: float, std: float) -> str:
    """A mean with its standard deviation; a dash where there is nothing, such as the speed of waves without a wave."""
    if not math.isfinite(mean):
        return "–"
    return f"{mean:.2f} ± {std:.2f}" if math.isfinite(std) else f"{mean:.2f}"


def _error_cells(summary: Mapping[str, float], names: Sequence[str]) -> list[str]:
    values = ((summary[name], 3 if name in _SMALL else 2) for name in names)
    return [f"{value:.{digits}f}" if math.isfinite(value) else "–" for value, digits in values]
