"""The command line: ``sugiyama``. Arguments in, a table or one JSON document out; all work is done elsewhere.

Tables and documents go to stdout, everything else to stderr. What a user can mend ends in one line and exit code 2.
"""

import dataclasses
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, index
from sugiyama_ros.effects.registry import ENTRIES
from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.road import Array, Road

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.compare import Compared
    from sugiyama_ros.fit.classes import Classes
    from sugiyama_ros.fit.driver import Formulation
    from sugiyama_ros.nodes.run import RunResult
    from sugiyama_ros.simulation.simulator import Simulation

app = typer.Typer(
    help="Live, honest estimation of how people drive.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_out, _err = Console(), Console(stderr=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
Ring = Annotated[
    float | None, typer.Option("--ring", help="Circumference [m] of the road where the file does not tell.")
]
Out = Annotated[Path, typer.Option("--output", "-o", help="MCAP file to write.")]
Rate = Annotated[str, typer.Option("--rate", help="Times real time, or max: as fast as the nodes take it.")]
Separate = Annotated[bool, typer.Option("--processes", help="Each node in a process of its own.")]
ModelFile = Annotated[Path | None, typer.Option("--model", help="Model file (YAML) that `diagnose -o` wrote.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything random.")]


@app.command()
def demo(
    data: Annotated[
        Path | None, typer.Option("--data", help="Measured trajectories instead of simulated ones.")
    ] = None,
    output: Out = Path("sugiyama-demo.mcap"),
    ring: Ring = None,
    hidden: Annotated[
        str, typer.Option("--hidden", help="Effect that the simulated drivers have and the model lacks; or random.")
    ] = "slow_patch",
    seed: Seed = 1,
    show: Annotated[bool, typer.Option("--open", help="Open the page that it writes in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Replay an experiment with a hidden effect as ROS topics, find out what is missing, add it, and replay again.

    With --data, the drivers of a measured experiment are estimated instead.
    """
    if data is not None:
        _print_run(_run(data, output, 0.0, False, ring), as_json)
        return
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.diagnosis.verdict import document, sentences
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats.convert import write_trajectories
    from sugiyama_ros.page.recording import read_recording
    from sugiyama_ros.page.report import write_report
    from sugiyama_ros.studies.hiding import STRENGTHS, hide

    if hidden == "random":
        hidden = list(STRENGTHS)[int(np.random.default_rng(seed).integers(len(STRENGTHS)))]
    if hidden not in STRENGTHS:
        raise InputError(f"--hidden {hidden}: not among {', '.join(STRENGTHS)}, random")
    simulated, values = hide(hidden, STRENGTHS[hidden][0], seed)
    _err.print("22 simulated drivers on a ring of 230 m, 250 s. They have something that the model lacks.")
    with tempfile.TemporaryDirectory() as directory:
        source, model = Path(directory) / "simulated.mcap", Path(directory) / "model.yaml"
        write_trajectories(simulated.measured, source)
        before = _run(source, Path(directory) / "before.mcap", 0.0, False, None)
        with _stages() as advance:
            found = find(
                simulated.measured,
                seed=seed,
                quick=True,
                most=1,
                verdict_only=True,
                workers=os.cpu_count() or 1,
                on_progress=advance,
            )
        write_model(model, found.data, found.final)
        after = _run(source, output, 0.0, False, None, model)
    page = output.with_suffix(".html")
    write_report(read_recording(output), document(found), page)
    if show:
        typer.launch(str(page))
    rmse = [math.sqrt(sum(d.one_step_rmse_m**2 for d in r.drivers) / len(r.drivers)) for r in (before, after)]
    if as_json:
        _print_json(
            {
                "hidden": {"name": hidden, "parameters": values},
                **document(found),
                "published_one_step_rmse_m": {"before": rmse[0], "after": rmse[1]},
                "messages_lost": before.messages_lost + after.messages_lost,
                "output": str(output),
                "report": str(page),
            }
        )
        return
    _out.print(f"before: the estimators' one-step error is {rmse[0]:.4f} m", highlight=False)
    for line in sentences(found):
        _out.print(escape(line), soft_wrap=True, highlight=False)
    _out.print(f"after: with what was found, it is {rmse[1]:.4f} m; all topics are in {output}", highlight=False)
    truth = ", ".join(f"{k} {v:.3g}" for k, v in values.items())
    _out.print(f"hidden was: {hidden} ({truth})", highlight=False)
    _out.print(f"a page to look at: {escape(str(page))}", soft_wrap=True, highlight=False)


@app.command()
def run(
    source: Annotated[Path, typer.Argument(help="Trajectories: .data, .csv or .mcap.")],
    output: Out,
    rate: Rate = "max",
    processes: Separate = False,
    ring: Ring = None,
    model: ModelFile = None,
    critic: Annotated[bool, typer.Option("--critic", help="A critic listens and publishes /verdict.")] = False,
    save_state: Annotated[
        Path | None, typer.Option("--save-state", help="Directory in which to keep what was learnt of every driver.")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option("--resume", help="Directory of an earlier --save-state, to go on from.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Replay trajectories as ROS topics through one estimator for each driver, and record all topics."""
    _print_run(_run(source, output, _rate(rate), processes, ring, model, critic, save_state, resume), as_json)


@app.command()
def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .mcap or .csv.")],
    vehicles: Annotated[int, typer.Option(min=1, help="Number of vehicles.")] = 22,
    ring: Annotated[float, typer.Option(min=0.0, help="Circumference [m]; 0: an open road.")] = 230.0,
    duration: Annotated[float, typer.Option(min=1.0, help="Length of the run [s].")] = 250.0,
    gap: Annotated[float, typer.Option(help="Gap [m] between vehicles at the start, from rest.")] = 2.0,
    period: Annotated[float, typer.Option(min=0.01, max=2.0, help="Time [s] between samples.")] = 1.0 / 3.0,
    horizon: Annotated[
        int | None, typer.Option(min=1, max=100, help="Periods of look-ahead; as in the paper if left out.")
    ] = None,
    spread: Annotated[float, typer.Option(min=0.0, max=1.0, help="Relative std of v* and kappa_v over drivers.")] = 0.0,
    parameter: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE of a parameter, for all drivers; may be repeated.")
    ] = None,
    effect: Annotated[
        list[str] | None, typer.Option("--effect", help="NAME:PARAMETER=VALUE[,...] of an effect; may be repeated.")
    ] = None,
    model: ModelFile = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Simulate drivers on a ring or an open road, and write what a camera would have measured."""
    from sugiyama_ros.formats.convert import write_trajectories
    from sugiyama_ros.formats.plain_csv import write_csv

    writers: dict[str, Callable[[Any, Path], object]] = {".mcap": write_trajectories, ".csv": write_csv}
    if output.suffix not in writers:
        raise InputError(f"{output}: cannot be written as {output.suffix or 'nothing'}; give a .mcap or .csv name")
    simulated = _simulated(
        vehicles, ring, duration, gap, period, horizon, spread, seed, parameter or [], effect or [], model
    )
    writers[output.suffix](simulated.measured, output)
    speed = simulated.speed[len(simulated.speed) // 2 :]
    second_half = {"v_avg": speed.mean(), "v_min": speed.min(axis=1).mean(), "v_max": speed.max(axis=1).mean()}
    document = {
        "output": str(output),
        "vehicles": vehicles,
        "steps": len(simulated.speed),
        "duration_s": simulated.measured.duration_s,
        "second_half": second_half,
        "collisions": [dataclasses.asdict(c) for c in simulated.collisions],
        "seed": seed,
    }
    if as_json:
        _print_json(document)
        return
    _out.print(f"{vehicles} vehicles, {simulated.measured.duration_s:.1f} s, in {escape(str(output))}", soft_wrap=True)
    shown = ", ".join(f"{name} {value:.2f}" for name, value in second_half.items())
    _out.print(f"second half: {shown} m/s")
    _tell_collisions(simulated)


@app.command()
def calibrate(
    source: Annotated[Path, typer.Argument(help="Trajectories: .data, .csv or .mcap.")],
    formulation: Annotated[
        str, typer.Option("--formulation", help="paper: perceived states are smoothed; causal: they are filtered.")
    ] = "causal",
    parameters: Annotated[
        str, typer.Option("--parameters", help="Names, separated by commas, of what is estimated.")
    ] = "sigma_nu,sigma_a,v_star,kappa_v",
    effects: Annotated[
        str, typer.Option("--effects", help="Names, separated by commas, of effects to fit with it (causal).")
    ] = "",
    regularise: Annotated[
        bool,
        typer.Option("--regularise", help="causal: drivers are draws of one population; paper: its own penalty."),
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Intervals from the profile likelihood, without --effects; takes longer.")
    ] = False,
    hops: Annotated[
        int,
        typer.Option("--hops", min=0, help="Hops of basinhopping before the search, without --effects; paper: 100."),
    ] = 0,
    classes: Annotated[
        int, typer.Option("--classes", min=0, help="Classes of drivers who share all parameters, for short records.")
    ] = 0,
    seed: Seed = 0,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Dask scheduler, as tcp://host:8786, whose workers do the work.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Model file (YAML) to write.")] = None,
    ring: Ring = None,
    as_json: Json = False,
) -> None:
    """Estimate every driver's parameters by maximum likelihood, and say how well the data hold them."""
    from sugiyama_ros.calibration import all_together, each_for_himself, in_classes
    from sugiyama_ros.formats import read_trajectories
    from sugiyama_ros.workers import workers

    if formulation not in ("paper", "causal"):
        raise InputError(f"--formulation {formulation}: give paper or causal")
    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise InputError(f"{output}: give a model file a .yaml name")
    names, added = _names(parameters), _names(effects)
    if added and formulation == "paper":
        raise InputError("--effects: the paper's formulation knows none; use --formulation causal")
    pooled = bool(added) or (regularise and formulation == "causal")
    if (profile or hops) and pooled:
        raise InputError("--profile and --hops: are of one driver by himself; leave --effects and --regularise out")
    if classes and (pooled or profile or hops or regularise):
        raise InputError("--classes: share all parameters; leave --effects, --regularise, --profile and --hops out")
    form: Formulation = "paper" if formulation == "paper" else "causal"
    trajectories = read_trajectories(source, ring)
    began = time.monotonic()
    with _progress("calibrating") as advance, workers(len(trajectories.vehicle), scheduler) as work:
        kept = output.with_name(output.name + ".fits") if output is not None else None
        if pooled:
            found = all_together(trajectories, names, added, work)
        elif classes:
            found = in_classes(trajectories, form, names, classes, seed, work)
        else:
            found = each_for_himself(
                trajectories,
                form,
                names,
                is_regularised=regularise,
                profiled=profile,
                hops=hops,
                seed=seed,
                work=work,
                kept=kept,
                on_progress=advance or (lambda done, total: None),
            )
    wall_s = time.monotonic() - began
    if output is not None and kept is not None:
        found.write(output)
        kept.unlink(missing_ok=True)
    places = [index(name) for name in names]
    drivers: list[dict[str, Any]] = [
        {
            "vehicle": int(vehicle),
            **{name: float(row[k]) for name, k in zip(names, places, strict=True)},
            "log_likelihood": float(value),
            "std": std,
            "interval": {name: interval[k].tolist() for name, k in zip(names, places, strict=True)},
            "identified": identified,
        }
        for vehicle, row, value, std, interval, identified in zip(
            trajectories.vehicle,
            found.rows,
            found.log_likelihood,
            found.std,
            found.interval,
            found.identified,
            strict=True,
        )
    ]
    together = _effects_of(found.rows, found.shared_std)
    document: dict[str, Any] = {
        "formulation": formulation,
        "drivers": drivers,
        "effects": together,
        "log_likelihood": float(found.log_likelihood.sum()),
        "wall_s": wall_s,
    }
    if found.classes is not None:
        document |= {"classes": _classes_of(found.classes, names), "bic": found.classes.bic}
        for driver, probability in zip(drivers, found.classes.probability.tolist(), strict=True):
            driver["class_probability"] = probability
    if as_json:
        _print_json(document)
        return
    for number, one in enumerate(document.get("classes", [])):
        told = ", ".join(f"{n} {one[n]:.3f} ± {one['std'][n]:.3f}" for n in names)
        _out.print(f"class {number}: {one['share']:.0%} of the drivers, {told}", soft_wrap=True, highlight=False)
    if found.classes is not None:
        said = (
            f"Bayesian information criterion {found.classes.bic:.1f}: the number of classes with the smallest is best"
        )
        _out.print(said, soft_wrap=True, highlight=False)
    table = Table(title=f"Calibration, {formulation} formulation", title_justify="left")
    for heading in ("vehicle", *names, "log-likelihood"):
        table.add_column(heading, justify="right")
    for d in drivers:
        spread = {n: "{:.3f} to {:.3f}".format(*d["interval"][n]) if profile else f"± {d['std'][n]:.3f}" for n in names}
        cells = [f"{d[n]:.3f} {spread[n] if d['identified'][n] else '(not identified)'}" for n in names]
        table.add_row(str(d["vehicle"]), *cells, f"{d['log_likelihood']:.1f}")
    mean = found.rows[:, places].mean(axis=0)
    table.add_row("mean", *(f"{m:.3f}" for m in mean), f"{document['log_likelihood']:.1f}")
    _print_wide(table)
    for name, values in together.items():
        _out.print(f"{name}: " + ", ".join(f"{p} {v['value']:.4g} ± {v['std']:.2g}" for p, v in values.items()))
    if output is not None:
        _out.print(f"model file: {escape(str(output))}", soft_wrap=True, highlight=False)


def _classes_of(classes: "Classes", names: list[str]) -> list[dict[str, Any]]:
    """Share of the drivers, parameters and their stds, of each class."""
    places = [index(name) for name in names]
    return [
        {
            "share": float(share),
            **dict(zip(names, row[places].tolist(), strict=True)),
            "std": dict(zip(names, std[places].tolist(), strict=True)),
        }
        for share, row, std in zip(classes.share, classes.rows, classes.std, strict=True)
    ]


def _effects_of(rows: Array, shared_std: Mapping[str, float]) -> dict[str, dict[str, dict[str, float]]]:
    """Value and std of what was fitted for all drivers alike, by effect (or by the model itself) and parameter."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for entry, std in shared_std.items():
        name, _, parameter = entry.rpartition(".")
        value = float(rows[0, ENTRIES.index(entry)])
        found.setdefault(name or "constants", {})[parameter] = {"value": value, "std": std}
    return found


@app.command()
def diagnose(
    source: Annotated[Path, typer.Argument(help="Trajectories: .data, .csv or .mcap.")],
    add: Annotated[
        str | None, typer.Option("--add", help="auto: add what is missing until nothing more is supported.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Model file (YAML) to write: all that was added.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer simulated recordings: rougher p-values, sooner.")
    ] = False,
    ring: Ring = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say what is missing from the model: where it fails, which effect explains that, and how sure that is."""
    from sugiyama_ros.diagnosis.diagnosis import diagnose as find
    from sugiyama_ros.diagnosis.verdict import document, sentences
    from sugiyama_ros.fit.model_file import write_model
    from sugiyama_ros.formats import read_trajectories

    if add not in (None, "auto"):
        raise InputError(f"--add {add}: only auto is known")
    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise InputError(f"{output}: give a model file a .yaml name")
    trajectories = read_trajectories(source, ring)
    with _stages() as advance:
        found = find(
            trajectories,
            seed=seed,
            quick=quick,
            most=8 if add else 3,
            add_forces=add is not None,
            workers=os.cpu_count() or 1,
            on_progress=advance,
        )
    if output is not None:
        write_model(output, found.data, found.final)
    if as_json:
        _print_json(document(found))
        return
    for line in sentences(found):
        _out.print(escape(line), soft_wrap=True, highlight=False)
    table = Table(title="Held-out errors, step by step", title_justify="left")
    steps = [("base model", found.before), *((f"+ {n.name}", n.after) for n in found.named)]
    names = {name: value for name, value in found.rivals.items()}
    for heading in ("model", *_ERROR_HEADINGS):
        table.add_column(escape(heading), justify="left" if heading == "model" else "right")
    for name, summary in [*((n, e.summary()) for n, e in steps), *names.items()]:
        table.add_row(escape(name), *_error_cells(summary))
    _print_wide(table)
    _print_drivers(document(found)["drivers"])
    runs = f"{found.bootstrap_runs} simulated recordings" + (" (quick)" if quick else "")
    _err.print(f"p-values from {runs}; {found.wall_s:.0f} s")


@app.command()
def study(
    name: Annotated[str, typer.Argument(help="Which study; without one, the list of all.")] = "",
    source: Annotated[
        Path | None, typer.Argument(help="Trajectories of measured drivers: .data, .csv or .mcap.")
    ] = None,
    runs: Annotated[int, typer.Option("--runs", min=1, help="Simulated runs of each case.")] = 8,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Picture to write: .png or .pdf.")] = None,
    ring: Ring = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Answer a question of the paper anew, by simulation or on measured drivers."""
    from sugiyama_ros.formats import read_trajectories
    from sugiyama_ros.studies.registry import STUDIES
    from sugiyama_ros.studies.registry import study as study_of
    from sugiyama_ros.studies.study import Asked
    from sugiyama_ros.workers import workers

    if not name:
        for one in STUDIES.values():
            _out.print(f"{one.name:12} {one.question}", highlight=False)
        return
    if output is not None and output.suffix not in (".png", ".pdf"):
        raise InputError(f"{output}: give a picture a name that ends in .png or .pdf")
    asked = study_of(name)
    trajectories = read_trajectories(source, ring) if source is not None else None
    with workers(runs) as work:
        answer = asked.answer(Asked(trajectories, runs, seed, work))
        if output is not None:
            _draw(answer.draw, output)
    if as_json:
        _print_json({"study": name, "paper": asked.paper, "rows": answer.rows, "seed": seed})
        return
    headings = list(dict.fromkeys(heading for row in answer.rows for heading in row))
    table = Table(title=asked.question, title_justify="left")
    for heading in headings:
        table.add_column(escape(heading), justify="right")
    for row in answer.rows:
        cells = (row.get(heading, "") for heading in headings)
        table.add_row(*(f"{c:.4g}" if isinstance(c, float) else escape(str(c)) for c in cells))
    _print_wide(table)
    _out.print(f"The paper: {asked.paper}", soft_wrap=True, highlight=False)


def _draw(draw: Callable[[Any], None], output: Path) -> None:
    from sugiyama_ros.formats.writing import replacing

    _needs_matplotlib("--output")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    draw(figure)
    with replacing(output) as stream:
        figure.savefig(stream, dpi=120, format=output.suffix[1:])


def _needs_matplotlib(option: str) -> None:
    if find_spec("matplotlib") is None:
        raise InputError(f"{option}: matplotlib is not installed; pip install 'sugiyama_ros[pictures]'")


@app.command()
def compare(
    source: Annotated[Path, typer.Argument(help="Trajectories: .data, .csv or .mcap.")],
    effects: Annotated[str, typer.Option("--effects", help="Effects to add to the model, separated by commas.")] = "",
    model: ModelFile = None,
    ring: Ring = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Compare the model with the measurements, and with other models, on samples that no fit has seen."""
    from sugiyama_ros.diagnosis.compare import collective_of
    from sugiyama_ros.diagnosis.compare import compare as compare_models
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.formats import read_trajectories

    given = read_model(model) if model is not None else None
    trajectories = read_trajectories(source, ring)
    names = _names(effects)
    with _stages() as advance:
        compared = compare_models(
            trajectories, names, given, seed=seed, workers=os.cpu_count() or 1, on_progress=advance
        )
    measured = collective_of(trajectories)
    document = {
        "models": [
            {
                "name": c.name,
                **c.errors.summary(),
                **c.errors.details(),
                "collective": {name: {"mean": m, "std": s} for name, (m, s) in c.collective.items()},
                "drivers": [
                    {"vehicle": int(v), "log_likelihood": ll, "single_car_10s_m": error}
                    for v, (ll, error) in zip(trajectories.vehicle, c.errors.by_driver(), strict=True)
                ],
                "heldout_gain_nats": c.gain.nats if c.gain else 0.0 if c.name == "base" else None,
                "heldout_gain_se": c.gain.se if c.gain else None,
                "nis_mean": c.nis_mean,
                "nis_std_error": c.nis_std_error,
                "autocorrelation": c.autocorrelation,
                "autocorrelation_band": c.band,
            }
            for c in compared
        ],
        "measured": dataclasses.asdict(measured),
        "seed": seed,
    }
    if as_json:
        _print_json(document)
        return
    table = Table(title="Held-out errors", title_justify="left")
    for heading in ("model", *_ERROR_HEADINGS, "gain [nats]", "mean NIS", "autocorrelation"):
        table.add_column(escape(heading), justify="left" if heading == "model" else "right")
    for c in compared:
        won = f"{c.gain.nats:.0f} ± {c.gain.se:.0f}" if c.gain else ""
        nis = f"{c.nis_mean:.2f} ± {c.nis_std_error:.2f}"
        table.add_row(escape(c.name), *_error_cells(c.errors.summary()), won, nis, f"{c.autocorrelation[0]:+.3f}")
    _print_wide(table)
    _print_details(compared)
    _print_collective(dataclasses.asdict(measured), compared)
    _out.print(f"white innovations have an autocorrelation within ± {compared[0].band:.3f}", highlight=False)


@app.command()
def report(
    source: Annotated[Path, typer.Argument(help="MCAP file that `run` recorded.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="HTML file to write.")] = None,
    diagnosis: Annotated[
        Path | None, typer.Option("--diagnosis", help="Document that `diagnose --json` printed of the same data.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Directory in which to write figures for a paper too: PDF and PNG.")
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Write a page to look at: what was measured, what the model says, where it fails, what is missing."""
    from sugiyama_ros.page.recording import read_diagnosis, read_recording
    from sugiyama_ros.page.report import write_report

    page = output or source.with_suffix(".html")
    if page.suffix != ".html":
        raise InputError(f"{page}: give the page a .html name")
    if figures is not None:
        _needs_matplotlib("--figures")
    found, recording = read_diagnosis(diagnosis) if diagnosis is not None else None, read_recording(source)
    write_report(recording, found, page)
    written: list[Path] = []
    if figures is not None:
        from sugiyama_ros.page.figures import write_figures

        written = write_figures(recording, found, figures)
    text = f"page: {page}" + (f"; {len(written)} figures in {figures}" if written else "")
    _tell({"output": str(page), "size_bytes": page.stat().st_size, "figures": written}, text, as_json)
    if show:
        typer.launch(str(page))


@app.command()
def live(
    source: Annotated[
        Path | None, typer.Argument(help="Trajectories to replay; without, the page shows the graph that runs.")
    ] = None,
    output: Out = Path("sugiyama-live.mcap"),
    rate: Rate = "1",
    ring: Ring = None,
    model: ModelFile = None,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; beyond this machine, the page asks for a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1024, max=65535, help="Port to listen on.")] = 5006,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
) -> None:
    """Serve a page that shows the topics while they come, for this machine alone; Ctrl-C ends it."""
    from sugiyama_ros.nodes.live import serve

    def ready(url: str) -> None:
        _err.print(f"live page: {url} (Ctrl-C ends it)", soft_wrap=True)
        if show:
            typer.launch(url)

    _err.print("starting the nodes")
    serve(source, output, rate=_rate(rate), ring_m=ring, model=model, host=host, port=port, on_ready=ready)


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(help="Trajectories: .data, .csv or .mcap.")],
    output: Annotated[Path, typer.Argument(help="MCAP file to write.")],
    ring: Ring = None,
    as_json: Json = False,
) -> None:
    """Convert trajectories to MCAP, with the topics /road and /measured."""
    from sugiyama_ros.formats.convert import convert as convert_file

    t = convert_file(source, output, ring)
    document = {
        "output": str(output),
        "vehicles": len(t.vehicle),
        "steps": len(t.position_m),
        "period_s": t.period_s,
        "ring_m": t.road.circumference_m or None,
        "sha256": t.sha256,
    }
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road (a ring? give --ring METRES)"
    text = f"{len(t.vehicle)} vehicles, {len(t.position_m)} samples of {t.period_s:.4g} s on {road}, in {output}"
    _tell(document, text, as_json)


@app.command()
def fetch(
    name: Annotated[str, typer.Argument(help="Name of the data set: sugiyama2008.")],
    directory: Annotated[Path, typer.Option("--directory", "-d", help="Where to put it.")] = Path(),
    accept_licence: Annotated[bool, typer.Option("--accept-licence", help="Accept its terms without asking.")] = False,
    url: Annotated[str | None, typer.Option(help="Another address of the same file.")] = None,
    as_json: Json = False,
) -> None:
    """Download a public data set, check it, and convert it to MCAP."""
    from sugiyama_ros.formats.catalogue import CATALOGUE
    from sugiyama_ros.formats.fetch import fetch as download

    if name not in CATALOGUE:
        raise InputError(f"{name}: not in the catalogue; it has {', '.join(CATALOGUE)}")
    _err.print(escape(CATALOGUE[name].licence))
    if not accept_licence:
        if not sys.stdin.isatty():
            raise InputError(f"{name}: its terms were not accepted; add --accept-licence")
        typer.confirm("Do you accept these terms?", abort=True, err=True)
    with _progress("downloading") as advance:
        fetched = download(name, directory, url, advance)
    _tell(dataclasses.asdict(fetched), f"{fetched.data}\n{fetched.bag}", as_json)


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="MCAP file.")],
    as_json: Json = False,
) -> None:
    """Tell what is in an MCAP file, as `ros2 bag info` does."""
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(file) as bag:
        about = bag.info()
    if as_json:
        _print_json(dataclasses.asdict(about))
        return
    lines = {
        "Files": about.file,
        "Bag size": f"{about.size_bytes / 1024:.1f} KiB",
        "Storage id": about.storage,
        "Compression": ", ".join(about.compression) or "none",
        "Duration": f"{about.duration_s:.9g} s",
        "Start": _moment(about.start_ns),
        "End": _moment(about.end_ns),
        "Messages": str(about.messages),
    }
    for key, value in lines.items():
        _out.print(f"{key + ':':<13}{escape(value)}", soft_wrap=True, highlight=False)
    for record, values in about.metadata.items():
        shown = ", ".join(f"{key}={value}" for key, value in values.items())
        _out.print(f"{'Metadata:':<13}{escape(f'{record}: {shown}')}", soft_wrap=True, highlight=False)
    table = Table("topic", "type", "messages", "reliability", "durability", box=None)
    for topic in about.topics:
        cells = (topic.name, topic.type, str(topic.count), topic.reliability, topic.durability)
        table.add_row(*(escape(cell) for cell in cells))
    _print_wide(table)


@app.command()
def echo(
    file: Annotated[Path, typer.Argument(help="MCAP file.")],
    topic: Annotated[str, typer.Argument(help="Topic, such as /vehicle_07/innovation.")],
    as_json: Json = False,
) -> None:
    """Print the messages of one topic."""
    from sugiyama_ros.formats.cdr import plain
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(file) as bag:
        messages = bag.messages({topic})
        if as_json:
            sys.stdout.write("[")
            for number, (_, _, log_time_ns, message) in enumerate(messages):
                document = {"log_time_ns": log_time_ns, "message": plain(message)}
                sys.stdout.write(("," if number else "") + "\n" + _json(document))
            sys.stdout.write("\n]\n")
            return
        for _, _, log_time_ns, message in messages:
            sys.stdout.write(f"# {log_time_ns}\n{_json(plain(message), indent=2)}\n---\n")


@app.command()
def recover(
    file: Annotated[Path, typer.Argument(help="Cut or damaged MCAP file, or the .part that a killed run left.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; FILE without .part, or FILE.recovered.mcap.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Save what is whole of a cut or damaged MCAP file into a new one, and verify that."""
    from sugiyama_ros.formats.recover import recover as salvage

    if output is None:
        output = file.with_suffix("") if file.suffix == ".part" else file.with_suffix(".recovered.mcap")
        if output.exists():
            raise InputError(f"{output}: exists already; choose another name with --output")
    saved = salvage(file, output)
    text = (
        f"{saved.messages} messages on {saved.topics} topics saved and read back, {saved.lost_bytes} bytes lost;"
        f" in {saved.path}"
    )
    _tell(dataclasses.asdict(saved), text, as_json)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except SugiyamaError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        # whoever read our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _names(text: str) -> list[str]:
    """Of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _rate(text: str) -> float:
    """0 for max."""
    if text == "max":
        return 0.0
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.0 < rate < 1e6:
        raise InputError(f"--rate {text}: is not a rate; give a positive number, or max")
    return rate


def _run(
    source: Path,
    output: Path,
    rate: float,
    processes: bool,
    ring: float | None,
    model: Path | None = None,
    critic: bool = False,
    save_state: Path | None = None,
    resume: Path | None = None,
) -> "RunResult":
    try:
        from sugiyama_ros.nodes.run import run as run_nodes
    except ModuleNotFoundError as error:
        if error.name not in ("rclpy", "sugiyama_msgs"):
            raise
        raise InputError(f"{error.name}: not installed; run `make demo` once, or source a ROS 2 workspace") from None
    with _progress("replaying") as advance:
        return run_nodes(
            source,
            output,
            rate=rate,
            processes=processes,
            ring_m=ring,
            model=model,
            critic=critic,
            save_state=save_state,
            resume=resume,
            on_progress=advance,
        )


def _simulated(
    vehicles: int,
    ring_m: float,
    duration_s: float,
    gap_m: float,
    period_s: float,
    horizon: int | None,
    spread: float,
    seed: int,
    settings: Iterable[str],
    effects: Iterable[str],
    model: Path | None,
) -> "Simulation":
    """A run of drivers with the paper's parameters or those of a model file, changed by ``settings``, from rest."""
    from sugiyama_ros.driver.parameters import defaults, index
    from sugiyama_ros.effects.registry import switch_on, whole
    from sugiyama_ros.fit.model_file import read_model
    from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
    from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M

    rng = np.random.default_rng(seed)
    parameters = whole(defaults(vehicles))
    if model is not None:
        parameters = read_model(model).rows_of(np.arange(vehicles))
    for setting in settings:
        name, _, value = setting.partition("=")
        try:
            parameters[:, index(name)] = float(value)
        except ValueError:
            raise InputError(f"--set {setting}: is not NAME=VALUE with a number as value") from None
    for text in effects:
        name, _, pairs = text.partition(":")
        try:
            values = {k: float(v) for k, _, v in (pair.partition("=") for pair in pairs.split(","))}
        except ValueError:
            raise InputError(f"--effect {text}: is not NAME:PARAMETER=VALUE[,PARAMETER=VALUE]") from None
        parameters = switch_on(parameters, name, values)
    if spread > 0.0:
        for k in (V_STAR, KAPPA_V):
            parameters[:, k] *= np.exp(spread * rng.standard_normal(vehicles))
    length_m = np.full(vehicles, DEFAULT_LENGTH_M)
    start_m, road = platoon(length_m, gap_m), Road(ring_m)
    taken_m = float(start_m[-1] + length_m[-1])
    if road.is_ring and taken_m > ring_m:
        raise InputError(f"--ring {ring_m:g}: {vehicles} vehicles with gaps of {gap_m:g} m take {taken_m:.0f} m")
    simulator = Simulator(parameters, length_m, start_m, road, rng, period_s=period_s, horizon=horizon)
    return simulate(simulator, duration_s)


def _print_run(result: "RunResult", as_json: bool, truth: Array | None = None) -> None:
    """truth: (N, P) parameters of simulated drivers, to stand beside the estimates."""
    if as_json:
        _print_json(dataclasses.asdict(result))
        return
    table = Table(title="What the estimators know at the end", title_justify="left")
    headings = ["vehicle", "v* [m/s]", "kappa_v [s]", "one-step RMSE [m]", "mean NIS"]
    if truth is not None:
        headings[1:3] = [headings[1], "true", headings[2], "true"]
    for heading in headings:
        table.add_column(escape(heading), justify="right")
    for d in result.drivers:
        cells = [f"{d.v_star:.2f}", f"{d.kappa_v:.3f}", f"{d.one_step_rmse_m:.3f}", f"{d.nis_mean:.2f}"]
        if truth is not None:
            v_star, kappa_v = truth[d.vehicle, [V_STAR, KAPPA_V]]
            cells[:2] = [cells[0], f"{v_star:.2f}", cells[1], f"{kappa_v:.3f}"]
        table.add_row(str(d.vehicle), *cells)
    _out.print(table)
    _out.print(
        f"{result.steps} steps of {result.vehicles} vehicles at {result.real_time_factor:.0f} times real time;"
        f" {result.messages_recorded} messages recorded, {result.messages_lost} lost.",
        soft_wrap=True,
    )
    name = escape(str(result.output))
    _out.print(f"All topics are in {name} (sugiyama info {name}).", soft_wrap=True, highlight=False)
    if result.interrupted:
        _err.print("Interrupted: the recording ends early, but it is whole.")


def _tell_collisions(simulated: "Simulation") -> None:
    for c in simulated.collisions:
        _err.print(f"collision: vehicle {c.vehicle} into {c.leader} at {c.time_s:.1f} s; the run ends there")


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on a terminal; nothing in a pipe."""
    if not _err.is_terminal:
        yield None
        return
    columns = (TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_err, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def _stages() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for work in several stages, on a terminal; nothing in a pipe."""
    if not _err.is_terminal:
        yield lambda what, done, total: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, console=_err, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)


_ERROR_HEADINGS = (
    "one-step [m]",
    "free run 2 s [m]",
    "5 s",
    "10 s",
    "single car 2 s [m]",
    "5 s",
    "10 s",
    "nats per sample",
)


def _error_cells(summary: dict[str, float]) -> list[str]:
    return [
        f"{v:.3f}" if name in ("one_step_rmse_m", "loglik_per_sample") else f"{v:.2f}" for name, v in summary.items()
    ]


def _print_details(compared: "list[Compared]") -> None:
    """Errors of gap, speed and time gap after 10 s."""
    figures = {
        "gap [m]": "gap_m",
        "of mean gap [%]": "gap_relative",
        "fit [%]": "gap_fit_percent",
        "speed [m/s]": "speed_mps",
        "time gap [s]": "time_gap_s",
    }
    table = Table(title="Held-out errors of 10-s free runs: coupled, and of a single car", title_justify="left")
    for heading in ("model", *figures, *figures):
        table.add_column(escape(heading), justify="left" if heading == "model" else "right")
    for c in compared:
        details = c.errors.details()
        values = [
            details.get(f"{run}_10s_{name}", math.nan) * (100.0 if name == "gap_relative" else 1.0)
            for run in ("free_run", "single_car")
            for name in figures.values()
        ]
        table.add_row(escape(c.name), *(f"{v:.2f}" if abs(v) < 10.0 else f"{v:.0f}" for v in values))
    _print_wide(table)


def _print_collective(measured: dict[str, float], compared: "list[Compared]") -> None:
    table = Table(title="Collective measures: measured, and of simulations", title_justify="left")
    headings = ("mean speed [m/s]", "least", "largest", "wave speed [m/s]", "queue [vehicles]", "period [s]")
    for heading in ("", *headings):
        table.add_column(escape(heading), justify="left" if not heading else "right")
    table.add_row("measured", *(f"{v:.2f}" for v in measured.values()))
    for c in compared:
        if c.collective:
            table.add_row(escape(c.name), *(f"{m:.2f} ± {s:.2f}" for m, s in c.collective.values()))
    _print_wide(table)


def _print_drivers(drivers: list[dict[str, float]]) -> None:
    table = Table(title="By driver, before and after", title_justify="left")
    for heading in ("vehicle", "held-out gain [nats]", "single car 10 s [m]", "after"):
        table.add_column(escape(heading), justify="right")
    for d in drivers:
        errors = (f"{d[f'single_car_10s_{when}_m']:.2f}" for when in ("before", "after"))
        table.add_row(str(d["vehicle"]), f"{d['heldout_gain_nats']:.1f}", *errors)
    _print_wide(table)


def _moment(ns: int) -> str:
    # stamps of a recording are times of day, those of converted data seconds from its start
    return f"{ns / 1e9:.9f} ({datetime.fromtimestamp(ns / 1e9, tz=timezone.utc):%Y-%m-%d %H:%M:%S} UTC)"


def _tell(document: Any, text: str, as_json: bool) -> None:
    if as_json:
        _print_json(document)
    else:
        _out.print(escape(text), soft_wrap=True, highlight=False)


def _print_wide(table: Table) -> None:
    """Unbroken lines, also in a pipe, so that other programs can read them."""
    Console(width=max(_out.width, 200)).print(table, highlight=False)


def _print_json(document: Any) -> None:
    sys.stdout.write(_json(document, indent=2) + "\n")


def _json(document: Any, indent: int | None = None) -> str:
    return json.dumps(_strict(document), indent=indent, allow_nan=False)


def _strict(value: Any) -> Any:
    """What JSON can say: no NaN, no infinity, no numpy, no paths."""
    if isinstance(value, dict):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value.item() if isinstance(value, np.generic) else value


if __name__ == "__main__":
    main()
