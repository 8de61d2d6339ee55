"""The page's figures for a paper: one PDF and one PNG each, by matplotlib."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sugiyama_ros.outputs import Output, make_directory, writing
from sugiyama_ros.page.panels.base import BLUE, COLOURS, GREEN, GREY, ORANGE, VERMILION
from sugiyama_ros.page.panels.measured import speeds
from sugiyama_ros.page.panels.worth import error_growth
from sugiyama_ros.page.recording import Recording

_SIZE_IN, _DOTS_PER_IN = (6.0, 3.6), 200
_KINDS = ("pdf", "png")


def write_figures(
    r: Recording, diagnosis: Mapping[str, Any] | None, directory: Path, overwrite: bool = True
) -> list[Path]:
    """Write all figures that the data allow, each as a PDF and a PNG file.

    Parameters
    ----------
    r : Recording
        The run.
    diagnosis : mapping or None
        Document of `sugiyama diagnose --json`.
    directory : Path
        Where to write; made if it is not there.
    overwrite : bool
        Whether figures that are there already are replaced.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    OutputError
        Where a file cannot be written.
    """
    drawings: dict[str, Callable[[Any], None]] = {
        "space_time": lambda axes: _space_time(axes, r),
        "speeds": lambda axes: _speed_profile(axes, r),
    }
    if r.has_estimates:
        drawings["one_step_error"] = lambda axes: _by_driver(axes, r)
    if diagnosis is not None:
        drawings["candidates"] = lambda axes: _candidates(axes, diagnosis)
        drawings["free_runs"] = lambda axes: _growth(axes, diagnosis)
        drawings["before_and_after"] = lambda axes: _before_and_after(axes, diagnosis)
    make_directory(directory)
    outputs = {(name, kind): Output(directory / f"{name}.{kind}", overwrite) for name in drawings for kind in _KINDS}
    for output in outputs.values():
        output.check()
    for name, draw in drawings.items():
        figure = Figure(figsize=_SIZE_IN, layout="constrained")
        draw(figure.add_subplot())
        for kind in _KINDS:
            with writing(outputs[name, kind]) as stream:
                figure.savefig(stream, format=kind, dpi=_DOTS_PER_IN)
    return [output.path for output in outputs.values()]


def _space_time(axes: Any, r: Recording) -> None:
    t, speed = r.trajectories, speeds(r)
    time = np.broadcast_to(r.time_s[:, None], speed.shape)
    dots = axes.scatter(time, t.road.wrap(t.position_m), c=speed, s=2.0, cmap="cividis", linewidths=0, rasterized=True)
    axes.figure.colorbar(dots, label="speed [m/s]")
    axes.set(xlabel="time [s]", ylabel="position [m]")


def _speed_profile(axes: Any, r: Recording) -> None:
    speed = speeds(r)
    whole = np.isfinite(speed).any(axis=1)
    for label, of, colour in (("largest", np.nanmax, ORANGE), ("mean", np.nanmean, BLUE), ("least", np.nanmin, GREEN)):
        axes.plot(r.time_s[whole], of(speed[whole], axis=1), color=colour, label=label, linewidth=1.0)
    axes.set(xlabel="time [s]", ylabel="speed [m/s]")
    axes.legend(frameon=False)


def _by_driver(axes: Any, r: Recording) -> None:
    axes.bar([str(v) for v in r.trajectories.vehicle], r.error_by_driver, color=BLUE)
    axes.tick_params(axis="x", labelsize=6)
    axes.set(xlabel="vehicle", ylabel="one-step error [m]")


def _candidates(axes: Any, diagnosis: Mapping[str, Any]) -> None:
    best = [c for c in diagnosis["candidates"] if c["heldout_gain_nats"] is not None][:12][::-1]
    added = {n["name"] for n in diagnosis["verdict"]["effects"]}
    axes.barh(
        [c["name"].replace("_", " ") for c in best],
        [c["heldout_gain_nats"] for c in best],
        xerr=[c["heldout_gain_se"] or 0.0 for c in best],
        color=[VERMILION if c["name"] in added else BLUE for c in best],
    )
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set(xlabel="held-out gain [nats], with one standard error")


def _growth(axes: Any, diagnosis: Mapping[str, Any]) -> None:
    for (name, errors), colour in zip(diagnosis["errors"].items(), COLOURS, strict=False):
        axes.plot(*error_growth(errors, "free_run"), color=colour, label=f"{name.replace('_', ' ')}, all cars")
        axes.plot(*error_growth(errors, "single_car"), color=colour, linestyle="--")
    axes.set(xlabel="after [s]", ylabel="error of position [m]; dashed: one car")
    axes.legend(frameon=False, fontsize=7)


def _before_and_after(axes: Any, diagnosis: Mapping[str, Any]) -> None:
    names = [str(d["vehicle"]) for d in diagnosis["drivers"]]
    for label, colour, marker in (("before", GREY, "o"), ("after", BLUE, "s")):
        values = [d[f"single_car_10s_{label}_m"] for d in diagnosis["drivers"]]
        axes.scatter(
            names, [np.nan if v is None else v for v in values], color=colour, label=label, marker=marker, s=14
        )
    axes.tick_params(axis="x", labelsize=6)
    axes.set(xlabel="vehicle", ylabel="error after 10 s, one car [m]")
    axes.legend(frameon=False)
