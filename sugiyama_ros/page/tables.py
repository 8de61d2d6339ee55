"""Tables of a diagnosis and of a comparison, out of their documents, for the command line and for the page."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sugiyama_ros.page.names import MODELS, Document, model_name, models, nats, short_name
from sugiyama_ros.results import TextTable

# Rows that a comparison shows first.
_ROWS = 6
# Columns of gains, of one car, as headings and names; the gain over all is their sum.
_GAINS = {"one step": "one_step", "1 s": "1s", "2 s": "2s", "5 s": "5s", "10 s": "10s"}
_COLLECTIVE = {
    "mean speed [m/s]": "mean_speed",
    "least [m/s]": "least_speed",
    "largest [m/s]": "largest_speed",
    "wave speed [m/s]": "wave_speed",
    "queue [vehicles]": "queue_vehicles",
    "period [s]": "period_s",
}


def steps(d: Document) -> TextTable:
    """Return the base model, the model with the additions, and other laws: gains over the base model, and errors."""
    shown = {model_name(name): one for name, one in models(d).items()}
    return forecasts("Forecasts of unseen data; gains over the base model in nats", shown)


def ranked(c: Document) -> list[Document]:
    """The models of a comparison that count, the largest gain first: none in sample, and none on other samples."""
    counted = [one for one in c["models"] if one["kind"] not in ("in_sample", "simulated")]
    return sorted(counted, key=lambda one: -float(one["heldout_gain_nats"]))


def compared(c: Document, *, show_all: bool = False) -> TextTable:
    """Return the models of a comparison: gains over the base model, and errors."""
    asked = [one["name"] for one in c["models"] if one["kind"] in ("base", "asked", "given", "in_sample")]
    best = [one["name"] for one in ranked(c) if one["name"] not in asked]
    kept = {*asked, *best[: max(1, _ROWS - len(asked))]}
    rows = sorted(c["models"], key=lambda one: math.inf if one["kind"] == "simulated" else -one["heldout_gain_nats"])
    shown = {short_name(one["name"]): one for one in rows if show_all or one["name"] in kept}
    own = " (in sample: of the model that was fitted to them)" if any(o["kind"] == "in_sample" for o in rows) else ""
    return forecasts(f"Forecasts of unseen data{own}; gains over the base model in nats", shown)


def forecasts(title: str, shown: Mapping[str, Mapping[str, Any]]) -> TextTable:
    """Return models with their gains over the base model, over all horizons and at each, and their errors.

    shown: errors and ``gains`` of each model, by its name.
    """
    is_road = any(one.get("free_run_10s_m") is not None for one in shown.values())
    run = "free_run" if is_road else "single_car"
    errors = {
        "CRPS 10 s [m]": f"{run}_10s_crps_m",
        "error 10 s [m]": f"{run}_10s_m",
        "one step [m]": "one_step_rmse_m",
    }
    title += f"; errors after 10 s of {'all cars' if is_road else 'one car'}"
    rows = []
    for name, one in shown.items():
        won = [one.get("gains", {}).get(column) for column in ("all", *_GAINS.values())]
        cells = (_gain(gain) for gain in won)
        rows.append(
            (name, *cells, *(_error(one.get(key), 3 if key.startswith("one") else 2) for key in errors.values()))
        )
    return TextTable(title, ("model", "gain", *_GAINS, *errors), tuple(rows), left=1)


def _gain(one: Mapping[str, float] | None) -> str:
    return "" if one is None else nats(one["nats"], one["se"]) if one["se"] > 0.0 or one["nats"] else "0"


def _error(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def by_driver(d: Document) -> TextTable:
    """Return the gain of the additions one step ahead for each driver, and the errors before and after."""
    headings = ("vehicle", "gain, one step [nats]", "one car 10 s, before [m]", "after [m]")
    rows = tuple(
        (
            f"{one.get('recording', '')} {one.get('name', one['vehicle'])}".strip(),
            f"{one['heldout_gain_nats']:.1f}",
            *(_error(one[f"single_car_10s_{when}_m"], 2) for when in MODELS[:2]),
        )
        for one in d["drivers"]
    )
    return TextTable("By driver, before and after", headings, rows)


def collective(c: Document) -> TextTable | None:
    """Return what the whole road does: recorded, and simulated by each model of a comparison; None for tracks."""
    if c["measured"] is None:
        return None
    errors = {"wave_speed": c["wave_speed_se"]}
    rows = [("measured", [(c["measured"][name], errors.get(name)) for name in _COLLECTIVE.values()])]
    rows += [
        (short_name(one["name"]), [(one["collective"][name]["mean"], one["collective"][name]["std"])
                                   for name in _COLLECTIVE.values()])
        for one in c["models"]
        if one["collective"]
    ]  # fmt: skip
    cells: Sequence[tuple[str, ...]] = [(name, *(_with_std(*pair) for pair in values)) for name, values in rows]
    return TextTable("The whole road: recorded and simulated", ("", *_COLLECTIVE), tuple(cells), left=1)


def _with_std(mean: float | None, std: float | None) -> str:
    """A mean with its standard deviation; a dash where there is nothing, such as the speed of waves without a wave."""
    return "–" if mean is None else f"{mean:.2f} ± {std:.2f}" if std is not None else f"{mean:.2f}"
