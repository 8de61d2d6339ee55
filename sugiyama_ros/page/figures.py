"""The report's figures for a paper: each one as PDF, PNG, and its data as CSV."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from sugiyama_ros.arrays import Array
from sugiyama_ros.outputs import Output, make_directory, writing
from sugiyama_ros.page.names import model_name, title_of
from sugiyama_ros.page.panels.base import BLUE, GREEN, GREY, ORANGE, VERMILION, colour_of
from sugiyama_ros.page.panels.diagnosed import error_growth, found_in
from sugiyama_ros.page.panels.measured import fastest, places, speeds, speeds_of_run
from sugiyama_ros.page.recording import Recording

# One column of a paper, and fonts that are embedded as they are.
_SIZE_IN, _DOTS_PER_IN = (3.35, 2.5), 300
_STYLE = {"pdf.fonttype": 42, "font.size": 8.0, "axes.linewidth": 0.6, "lines.linewidth": 1.0}
_KINDS = ("pdf", "png", "csv")
#: Columns of a figure's data: values by name, all of one length.
Columns = Mapping[str, Sequence[Any] | Array]
Drawing = Callable[[Any], Columns]


def write_figures(
    r: Recording, diagnosis: Mapping[str, Any] | None, directory: Path, overwrite: bool = True
) -> list[Path]:
    """Write all figures that the data allow, each as a PDF and a PNG file, with its data as CSV. Raises OutputError."""
    drawings = {**_of_run(r), **(_of_diagnosis(r, diagnosis) if diagnosis is not None else {})}
    make_directory(directory)
    outputs = {(name, kind): Output(directory / f"{name}.{kind}", overwrite) for name in drawings for kind in _KINDS}
    for output in outputs.values():
        output.check()
    with rc_context(_STYLE):
        for name, draw in drawings.items():
            figure = Figure(figsize=_SIZE_IN, layout="constrained")
            columns = draw(figure.add_subplot())
            for kind in _KINDS:
                with writing(outputs[name, kind]) as stream:
                    if kind == "csv":
                        stream.write(_csv(columns).encode())
                    else:
                        figure.savefig(stream, format=kind, dpi=_DOTS_PER_IN)
    return [output.path for output in outputs.values()]


def _csv(columns: Columns) -> str:
    """Columns as CSV; empty cells for what is not known."""
    stream = io.StringIO()
    out = csv.writer(stream, lineterminator="\n")
    out.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        out.writerow("" if v is None or v != v else f"{v:.6g}" if isinstance(v, float) else v for v in row)
    return stream.getvalue()


def _of_run(r: Recording) -> dict[str, Drawing]:
    """Drawings of a run alone."""
    time = np.broadcast_to(r.time_s[:, None], r.trajectories.position_m.shape)
    found: dict[str, Drawing] = {
        "space_time": lambda axes: _space_time(axes, time, places(r), speeds(r), fastest(r)),
        "speeds": lambda axes: _speed_profile(axes, r),
    }
    if r.has_estimates:
        found["one_step_error"] = lambda axes: _by_driver(axes, r)
        found["desired_speed"] = lambda axes: _over_time(axes, r, "v_star", "desired speed v* [m/s]")
        found["risk_premium"] = lambda axes: _over_time(axes, r, "kappa_v", "risk premium κ_v [s]")
    return found


def _of_diagnosis(r: Recording, d: Mapping[str, Any]) -> dict[str, Drawing]:
    """Drawings of a diagnosis."""
    found: dict[str, Drawing] = {
        "candidates": lambda axes: _candidates(axes, d),
        "free_runs": lambda axes: _growth(axes, d),
        "before_and_after": lambda axes: _before_and_after(axes, d),
    }
    if all("v_star" in driver for driver in d["drivers"]):
        found["drivers"] = lambda axes: _drivers(axes, d)
    ring_m = r.trajectories.road.circumference_m
    for when in ("before", "after") if d["verdict"]["effects"] else ("before",):
        if d.get("free_run", {}).get("time_s"):
            found[f"space_time_{when}"] = lambda axes, when=when: _simulated(axes, r, d["free_run"], when)  # type: ignore[misc]
        for one in d.get("where", {}).get(when, {}).get("maps", []):
            if np.size(one["bias"]):  # recordings may have no places in common
                name = f"bias_{one['first']}_{one['second']}_{when}"
                found[name] = lambda axes, one=one: _bias(axes, one, d, ring_m)  # type: ignore[misc]
    return found


def _space_time(axes: Any, time: Array, place: Array, speed: Array, fast: float) -> Columns:
    dots = axes.scatter(time, place, c=speed, s=0.6, vmin=0.0, vmax=fast, cmap="cividis", linewidths=0, rasterized=True)
    axes.figure.colorbar(dots, label="speed [m/s]")
    axes.set(xlabel="time [s]", ylabel="position [m]")
    vehicle = np.broadcast_to(np.arange(place.shape[1]), place.shape)
    names = ("time_s", "column", "position_m", "speed_mps")
    return dict(zip(names, (a.ravel().tolist() for a in (time, vehicle, place, speed)), strict=True))


def _simulated(axes: Any, r: Recording, run: Mapping[str, Any], when: str) -> Columns:
    time_s, place = np.array(run["time_s"], dtype=np.float64), np.array(run[when], dtype=np.float64)
    speed = speeds_of_run(r.trajectories.road, time_s, np.array(run["block"]), place)
    return _space_time(axes, np.broadcast_to(time_s[:, None], place.shape), place, speed, fastest(r))


def _speed_profile(axes: Any, r: Recording) -> Columns:
    speed = speeds(r)
    whole = np.isfinite(speed).any(axis=1)
    columns: dict[str, Any] = {"time_s": r.time_s[whole].tolist()}
    for label, of, colour in (("largest", np.nanmax, ORANGE), ("mean", np.nanmean, BLUE), ("least", np.nanmin, GREEN)):
        columns[f"{label}_mps"] = of(speed[whole], axis=1).tolist()
        axes.plot(columns["time_s"], columns[f"{label}_mps"], color=colour, label=label)
    axes.set(xlabel="time [s]", ylabel="speed [m/s]", ylim=(min(0.0, float(np.nanmin(speed))), None))
    axes.legend(frameon=False)
    return columns


def _by_driver(axes: Any, r: Recording) -> Columns:
    names, error = [str(v) for v in r.trajectories.vehicle], r.error_by_driver.tolist()
    axes.bar(names, error, color=BLUE)
    axes.tick_params(axis="x", labelsize=5)
    axes.set(xlabel="vehicle", ylabel="one-step error [m]")
    return {"vehicle": names, "one_step_error_m": error}


def _over_time(axes: Any, r: Recording, name: str, label: str) -> Columns:
    value = r.series[name]
    axes.plot(r.time_s, value, color=GREY, linewidth=0.5, alpha=0.6)
    axes.plot(r.time_s, np.nanmedian(value, axis=1), color=VERMILION, linewidth=1.5)
    axes.set(xlabel="time [s]", ylabel=label)
    columns = {f"vehicle_{v}": value[:, k].tolist() for k, v in enumerate(r.trajectories.vehicle.tolist())}
    return {"time_s": r.time_s.tolist(), **columns}


def _candidates(axes: Any, d: Mapping[str, Any]) -> Columns:
    best = [c for c in d["candidates"] if c["heldout_gain_nats"] is not None][:12][::-1]
    effects = d["verdict"]["effects"]
    together = {n["name"] for n in effects} | {other for n in effects for other in n["indistinguishable"]}
    names = [title_of(d, c["name"]) for c in best]
    gain, se = ([c[f"heldout_gain_{of}"] or 0.0 for c in best] for of in ("nats", "se"))
    axes.barh(names, gain, xerr=se, color=[VERMILION if c["name"] in together else BLUE for c in best], ecolor=GREY)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.tick_params(axis="y", labelsize=6)
    axes.set(xlabel="held-out gain [nats]")
    p = [c.get("p_value") for c in best]
    return {"candidate": [c["name"] for c in best], "gain_nats": gain, "standard_error_nats": se, "p_value": p}


def _growth(axes: Any, d: Mapping[str, Any]) -> Columns:
    rows: list[tuple[str, str, float, float]] = []
    for name, errors in d["errors"].items():
        for run, style in (("free_run", "-"), ("single_car", "--")):
            seconds, values = error_growth(errors, run)
            label = model_name(name) if run == "free_run" else None
            axes.plot(seconds, values, style, color=colour_of(name, d), label=label)
            rows += [(name, run, s, v) for s, v in zip(seconds, values, strict=True)]
    axes.set(xlabel="after [s]", ylabel="error [m]; dashed: one car", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=5)
    return dict(zip(("model", "run", "after_s", "error_m"), zip(*rows, strict=True), strict=True)) if rows else {}


def _before_and_after(axes: Any, d: Mapping[str, Any]) -> Columns:
    columns: dict[str, list[Any]] = {"vehicle": [str(one["vehicle"]) for one in d["drivers"]]}
    for label, colour, marker in (("before", GREY, "o"), ("after", BLUE, "s")):
        values = [one[f"single_car_10s_{label}_m"] for one in d["drivers"]]
        columns[f"{label}_m"] = values
        known = [np.nan if v is None else v for v in values]
        axes.scatter(columns["vehicle"], known, color=colour, label=label, marker=marker, s=8)
    axes.tick_params(axis="x", labelsize=5)
    axes.set(xlabel="vehicle", ylabel="error after 10 s, one car [m]", ylim=(0.0, None))
    axes.legend(frameon=False)
    return columns


def _drivers(axes: Any, d: Mapping[str, Any]) -> Columns:
    names = ("vehicle", "v_star", "v_star_std", "kappa_v", "kappa_v_std")
    columns = {name: [one.get(name) for one in d["drivers"]] for name in names}
    std = {name: [s or 0.0 for s in columns[f"{name}_std"]] for name in ("v_star", "kappa_v")}
    axes.errorbar(
        columns["v_star"], columns["kappa_v"], std["kappa_v"], std["v_star"], "o", color=BLUE, ecolor=GREY, ms=3,
        elinewidth=0.6,
    )  # fmt: skip
    axes.set(xlabel="desired speed v* [m/s]", ylabel="risk premium κ_v [s]")
    return columns


def _bias(axes: Any, one: Mapping[str, Any], d: Mapping[str, Any], ring_m: float) -> Columns:
    first, second = (np.array(one[f"{name}_edges"], dtype=np.float64) for name in ("first", "second"))
    bias = np.array(one["bias"], dtype=np.float64)
    axes.set_facecolor("0.85")
    mesh = axes.pcolormesh(first, second, bias.T, cmap="PuOr_r", vmin=-0.5, vmax=0.5)
    axes.figure.colorbar(mesh, label="bias [std]")
    outlined = np.array(one.get("flagged", []), dtype=np.bool_).reshape(-1, bias.shape[1])
    for a, b in np.argwhere(outlined).tolist():
        corner, size = (first[a], second[b]), (first[a + 1] - first[a], second[b + 1] - second[b])
        axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor="black", linewidth=0.8))
    for _, covariate, low, high in found_in((one["first"], one["second"]), d, ring_m):
        for end in {low, high}:
            line = axes.axvline if covariate == one["first"] else axes.axhline
            line(end, color=VERMILION, linewidth=1.0, linestyle="--")
    axes.set(xlim=(first[0], first[-1]), ylim=(second[0], second[-1]))
    units = {"speed": "m/s", "gap": "m", "place": "m", "time": "s"}
    axes.set(xlabel=f"{one['first']} [{units[one['first']]}]", ylabel=f"{one['second']} [{units[one['second']]}]")
    i, j = (k.ravel() for k in np.indices(bias.shape))
    flagged = np.array(one.get("flagged", np.zeros(bias.shape)), dtype=np.int64)
    ends = {"low": 0, "high": 1}
    columns: dict[str, Any] = {f"{one['first']}_{end}": first[i + k].tolist() for end, k in ends.items()}
    columns |= {f"{one['second']}_{end}": second[j + k].tolist() for end, k in ends.items()}
    return {**columns, "bias_std": bias[i, j].tolist(), "flagged": flagged[i, j].tolist()}
