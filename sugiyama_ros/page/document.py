"""The documents of a diagnosis and of a comparison: numbers and names in SI units.

``--json`` prints them, and pages read them. The classes declare what a document holds; `read_diagnosis` of the page
checks files against them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.rounds import Diagnosis, Round
from sugiyama_ros.diagnosis.table import Difference, Entry, errors, gains
from sugiyama_ros.diagnosis.where import Located
from sugiyama_ros.driver.parameters import CONSTANTS, KAPPA_V, V_STAR, Parameter
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.fit.extent import not_searched
from sugiyama_ros.fit.standard_errors import own_stds
from sugiyama_ros.laws.registry import LAWS, PAPERS, name_of
from sugiyama_ros.statistics import ALPHA
from sugiyama_ros.verdict.compare import Compared, Comparison

# Time between two samples of a picture [s], and largest number of points of one run in the document.
_EVERY_S, _MOST = 0.6, 20_000


@dataclass(frozen=True)
class Addition:
    """Something that was added to the model.

    Parameters
    ----------
    name, form : str
        Name of the mechanism, and of the form of it that was added.
    kind : {"effect", "measurement", "force", "constants", "noise"}
        What it changes. Constants and noises explain nothing.
    step : int
        Number of the step in which it was added, from 0 on.
    parameters, parameters_std : dict of str to float
        Fitted values and their standard errors, SI units; none for values of each driver.
    covariate : str or None
        What a force without a name depends on.
    vehicles : list of int
        Numbers of the vehicles that show it; empty for all.
    is_supported : bool
        Whether the data ask for it. What somebody asks for is added even if they do not.
    doubts : list of {"score", "gain", "worse"}
        Why the data do not ask for it: its score does not stand out from what chance gives; unseen data are not
        forecast clearly better; some of their forecasts get worse.
    p_value : float
        Probability that chance gains as much in any candidate.
    heldout_gain_nats, heldout_gain_se : float
        What its step gains on unseen data, over all columns together [nats], with the standard error.
    gains : dict of str to dict
        ``nats`` and ``se`` of its step by column: ``one_step``, ``1s`` and so on for single cars, ``road_1s`` and so on
        for all cars of a road, ``all``.
    indistinguishable : list of str
        What the data cannot tell apart from it.
    advice : list of str
        What to record to tell them apart.
    closest_effect : dict or None
        Of a step without a physical effect: the effect that comes closest, by ``name``, and how far it is ``behind``
        [nats] with the standard error ``se``.
    free_run_rmse_before_m, free_run_rmse_after_m : float
        Error after 10 s before and after its step [m]: of all cars together; of single cars on tracks.
    """

    name: str
    form: str
    kind: str
    step: int
    parameters: dict[str, float]
    parameters_std: dict[str, float]
    covariate: str | None
    vehicles: list[int]
    is_supported: bool
    doubts: list[str]
    p_value: float
    heldout_gain_nats: float
    heldout_gain_se: float
    gains: dict[str, Difference]
    indistinguishable: list[str]
    advice: list[str]
    closest_effect: dict[str, Any] | None
    free_run_rmse_before_m: float
    free_run_rmse_after_m: float


@dataclass(frozen=True)
class Dropped:
    """Something that a step added and a later step took out again, because it was not needed any more beside the rest.

    Parameters
    ----------
    name, form, kind, covariate
        As of an addition.
    step, dropped_in : int
        Number of the step that added it, and of the step that took it out.
    free_run_rmse_before_m, free_run_rmse_after_m : float
        As of an addition.
    """

    name: str
    form: str
    kind: str
    covariate: str | None
    step: int
    dropped_in: int
    free_run_rmse_before_m: float
    free_run_rmse_after_m: float


@dataclass(frozen=True)
class Tried:
    """A candidate of the first round.

    Parameters
    ----------
    name, form, kind : str
        As of an addition.
    gain_nats : float
        Gain that its score predicts, in sample [nats].
    p_value : float
        Probability that chance gains as much in any candidate.
    heldout_gain_nats, heldout_gain_se : float or None
        Gain on unseen data over all columns [nats], and its standard error; None if it was not fitted.
    """

    name: str
    form: str
    kind: str
    gain_nats: float
    p_value: float
    heldout_gain_nats: float | None
    heldout_gain_se: float | None


def document(d: Diagnosis) -> dict[str, Any]:
    """Return everything that a diagnosis has found, in plain types and SI units.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.

    Returns
    -------
    dict
        ``verdict`` with ``outcome``, ``effects`` (each an `Addition`), ``dropped`` (each a `Dropped`), ``asked``,
        ``searched``, ``not_searched`` and ``fall``: how much of the error after 10 s [m] physical effects and faults
        of the measurement take away (``physics_m``), and how much all else (``other_m``).
        ``candidates``: a list of `Tried`. ``checks``: a list of `Check`. ``errors``: those of `errors` for ``before``,
        ``after``, ``floor`` (the final model on recordings that it simulates) and each law, with ``gains`` over
        ``before``. ``where``: bins and maps of the bias, before and after. ``smallest_detectable``: strengths from
        which effects would have shown. ``drivers``, ``free_run``, ``about``, ``data``, ``seed``, ``simulations``,
        ``wall_s``.
    """
    around = d.data.vicinity
    return {
        "verdict": {
            "outcome": d.outcome,
            "effects": [asdict(one) for one in additions(d)],
            "dropped": [asdict(one) for one in dropped_again(d)],
            "asked": list(d.asked),
            "searched": sorted({one.candidate.mechanism for one in d.rounds[0].scores}),
            "not_searched": [{"name": name, "reason": why} for name, why in not_searched(d.data).items()],
            "fall": _fall(d),
        },
        "candidates": [asdict(one) for one in _tried(d.rounds[0])],
        "checks": [asdict(one) for one in sorted(d.checks, key=lambda one: one.p_value)],
        "errors": _errors(d),
        "where": {"before": _where(d.where_before), "after": _where(d.where_after)},
        "smallest_detectable": list(d.smallest),
        "drivers": _drivers(d),
        "free_run": _drives(d),
        "about": about(),
        "data": {"source": around.source, "sha256": around.sha256},
        "law": _law(d),
        "vehicles": d.data.drivers,
        "drivers_left_out": d.data.left_out,
        "drivers_searched": d.searched.drivers,
        "decision_period_s": around.period_s,
        "decisions_per_sample": d.data.decisions,
        "counted_every_s": d.data.apart_s,
        "smoothed_s": d.data.smoothed_s,
        "has_other_noises": d.data.even.has_other_noises,
        "samples": d.data.measured_samples if around.is_whole_road else int(d.data.scored.sum()),
        "simulations": d.simulations,
        "seed": d.seed,
        "wall_s": d.wall_s,
    }


def additions(d: Diagnosis) -> list[Addition]:
    """What the final model has beyond the base model, in the order in which it was added."""
    found = []
    for step, one in enumerate(d.steps):
        before, after = _ends(one)
        names = {c.mechanism for c in one.new}
        alike = [name for name in dict.fromkeys(e.added[-1].mechanism for e in one.alike) if name not in names]
        for c in (c for c in one.new if c in d.final.added):
            parameters = {} if c.individual else _values(d.final, c)
            stds = {name: d.stds[key] for name in parameters for key in (f"{c.effect}.{name}", name) if key in d.stds}
            won = one.gain["all"]
            declared = EFFECTS[c.effect].advice if c.effect in EFFECTS else {}
            found.append(
                Addition(
                    name=c.mechanism,
                    form=c.effect,
                    kind=c.kind,
                    step=step,
                    parameters=parameters,
                    parameters_std=stds,
                    covariate=_covariate(c),
                    vehicles=[d.data.vicinity.numbers[i] for i in c.drivers],
                    is_supported=one.is_supported,
                    doubts=[] if one.is_supported else _doubts(one),
                    p_value=one.chance.p_values.get(c.mechanism, 1.0),
                    heldout_gain_nats=won.nats,
                    heldout_gain_se=won.se,
                    gains=dict(one.gain),
                    indistinguishable=alike,
                    advice=[declared[name] for name in alike if name in declared],
                    closest_effect=_closest(one) if not any(c.explains for c in one.new) else None,
                    free_run_rmse_before_m=before,
                    free_run_rmse_after_m=after,
                )
            )
    return found


def _ends(one: Round) -> tuple[float, float]:
    """Error after 10 s before and after a step [m]."""
    return _after_10_s(errors(one.current.forecasts)), _after_10_s(errors(one.after.forecasts))


def _doubts(one: Round) -> list[str]:
    """Why the data do not ask for what a round added."""
    doubts = {
        "score": any(one.chance.p_values.get(c.mechanism, 1.0) >= ALPHA for c in one.new),
        "gain": not one.gain["all"].is_clear,
        "worse": one.gain["all"].is_clear and not one.is_better,
    }
    return [name for name, holds in doubts.items() if holds]


def dropped_again(d: Diagnosis) -> Iterator[Dropped]:
    """What was added and taken out again, in the order in which it was added."""
    for step, one in enumerate(d.steps):
        for c in one.new:
            without = (k for k, later in enumerate(d.steps) if k > step and c not in later.after.added)
            if (dropped_in := next(without, None)) is not None:
                yield Dropped(c.mechanism, c.effect, c.kind, _covariate(c), step, dropped_in, *_ends(one))


def _covariate(c: Candidate) -> str | None:
    return COVARIATES[round(float(next(iter(c.starts[0].values())))) - 1] if c.kind == "force" else None


def _values(entry: Entry, c: Candidate) -> dict[str, float]:
    """Values of the parameters of a candidate, of a driver who has it; with those that stay at their start."""
    row = entry.fit.model.rows[c.drivers[0] if c.drivers else 0]
    places = sorted({*c.places, *c.starts[0]}) if c.kind == "force" else c.places
    return {ROW.declared[k].name: float(row[k]) for k in places}


def _closest(one: Round) -> dict[str, Any] | None:
    """The physical effect that comes closest to what was added in a step, and how far it is behind."""
    if one.closest_effect is None:
        return None
    name, behind = one.closest_effect
    return {"name": name, "behind_nats": behind.nats, "behind_se": behind.se}


def _after_10_s(found: dict[str, float]) -> float:
    """Error after 10 s: of all cars together, or of single cars."""
    return found["free_run_10s_m"] if math.isfinite(found["free_run_10s_m"]) else found["single_car_10s_m"]


def _fall(d: Diagnosis) -> dict[str, float]:
    """How much of the error after 10 s goes away [m], by what the steps add."""
    found = {"physics_m": 0.0, "other_m": 0.0}
    for one in d.steps:
        name = "physics_m" if any(c.explains for c in one.new) else "other_m"
        before, after = _ends(one)
        found[name] += before - after
    return found


def _tried(first: Round) -> list[Tried]:
    fitted = {e.added[-1].name: won["all"] for e, won in first.gains.items() if len(e.added) == 1}
    found: dict[str, Tried] = {}
    for entry in first.gains:
        c = entry.added[-1]
        if c.mechanism not in found:
            found[c.mechanism] = _one_tried(first, c, fitted.get(c.name))
    for score in first.scores:
        found.setdefault(score.candidate.mechanism, _one_tried(first, score.candidate, None))
    return list(found.values())


def _one_tried(first: Round, c: Candidate, won: Difference | None) -> Tried:
    gain = next((s.gain for s in first.scores if s.candidate.mechanism == c.mechanism), 0.0)
    p = first.chance.p_values.get(c.mechanism, 1.0)
    nats, se = (won.nats, won.se) if won is not None else (None, None)
    return Tried(c.mechanism, c.effect, c.kind, gain, p, nats, se)


def _errors(d: Diagnosis) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, entry in (("before", d.base), ("after", d.final), *((law.name, law) for law in d.laws)):
        won = entry.over(d.data, d.base)
        found[name] = {**errors(entry.forecasts), "gains": {k: asdict(v) for k, v in won.items()}}
    return {**found, "floor": d.floor} if d.floor else found


def _where(located: Located) -> dict[str, Any]:
    """All bins, the bins in which the model fails (the smallest p-value first), and maps of the bias."""
    return {
        "bins": [asdict(b) for b in located.bins],
        "flagged": [asdict(b) for b in located.flagged],
        "maps": [
            {
                "first": m.first,
                "second": m.second,
                "first_edges": m.first_edges.tolist(),
                "second_edges": m.second_edges.tolist(),
                "bias": [[None if np.isnan(b) else float(b) for b in row] for row in m.bias],
                "flagged": m.flagged.tolist(),
            }
            for m in located.maps
        ],
    }


def _drivers(d: Diagnosis) -> list[dict[str, Any]]:
    """Held-out gain of the additions and single-car errors before and after, for each driver."""
    before, after = d.base.forecasts, d.final.forecasts
    won = np.nansum(after.one_step - before.one_step, axis=1)
    ends = [_of_each(one.single.error[:, -1]) for one in (before, after)]
    rows, stds, law = d.final.fit.model.rows, own_stds(d.final.fit), _law(d)
    own = (V_STAR, KAPPA_V) if law == PAPERS else range(len(ROW.entries))[ROW.law_places[law]]
    return [
        {
            **name.document(),
            "heldout_gain_nats": float(won[i]),
            "single_car_10s_before_m": ends[0][i],
            "single_car_10s_after_m": ends[1][i],
            **{ROW.entries[k]: float(rows[i, k]) for k in own},
            **{f"{ROW.entries[k]}_std": stds[i].get(ROW.entries[k]) for k in own},
        }
        for i, name in enumerate(d.data.vicinity.names)
    ]


def _law(d: Diagnosis) -> str:
    """The law by which the drivers of the base model drive."""
    return name_of(float(d.base.fit.model.rows[0, ROW.law]))


def _of_each(error: Array) -> list[float]:
    """Root mean square of the errors (S, N) of each driver; NaN for who is not judged."""
    known = np.isfinite(error)
    with np.errstate(invalid="ignore"):
        mean: Array = np.square(np.where(known, error, 0.0)).sum(axis=0) / known.sum(axis=0)
    return list(np.sqrt(mean).tolist())


def _drives(d: Diagnosis) -> dict[str, Any]:
    """Free runs through all blocks of time with the model before and after the additions, thinned out.

    ``time_s`` (T,), ``block`` (T,), and the positions [m] ``before`` and ``after`` (T, N), wrapped on a ring; None
    where a vehicle is not there. On tracks there is no road to show, and the lists are empty.
    """
    around = d.data.vicinity
    if not around.is_whole_road:
        return {"time_s": [], "block": [], "before": [], "after": []}
    every = max(1, round(_EVERY_S / around.period_s), math.ceil(around.position_m.size / _MOST))
    return {
        "time_s": np.round(around.time_s[::every, 0], 3).tolist(),
        "block": d.data.block[0, ::every].tolist(),
        "before": _rows(d.driven_before[::every]),
        "after": _rows(d.driven_after[::every]),
    }


def _rows(position_m: Array) -> list[list[float | None]]:
    return [[round(x, 1) if np.isfinite(x) else None for x in row] for row in position_m.tolist()]


def about() -> dict[str, Any]:
    """Explain every name that the document mentions: its kind, title and summary, and what its parameters mean."""
    declared: dict[str, Any] = {p.name: p for p in ROW.declared}
    found = {
        c.name: _explained(c.title, c.summary, [declared[name] for name in c.parameters], "constants")
        for c in CONSTANTS
    }
    effects = {
        name: {**_explained(e.title, e.summary, e.parameters, "effect"), "is_limit": e.is_limit, "term": e.term}
        for name, e in EFFECTS.items()
    }
    laws = {name: _explained(law.title, law.summary, law.parameters, "law") for name, law in LAWS.items()}
    return {**found, **effects, **laws}


def _explained(title: str, summary: str, parameters: Sequence[Parameter], kind: str) -> dict[str, Any]:
    return {
        "title": title,
        "summary": summary,
        "kind": kind,
        "parameters": {
            p.name: {"unit": "" if p.unit == "1" else p.unit, "meaning": p.description, "axis": p.axis}
            for p in parameters
        },
    }


def comparison_document(c: Comparison) -> dict[str, Any]:
    """Return all results of a comparison in plain types, in SI units; the base model comes first."""
    held_out = [one for one in c.models if one.kind not in ("in_sample", "simulated")]
    best = max(held_out, key=lambda one: one.gain["all"].nats)
    return {
        "models": [_compared(c, one, best) for one in c.models],
        "measured": asdict(c.measured) if c.measured is not None else None,
        "wave_speed_se": c.wave_speed_se,
        "decision_period_s": c.vicinity.period_s,
        "drivers_left_out": c.data.left_out,
        "given": None if c.given is None else c.given._asdict(),
        "seed": c.seed,
    }


def _compared(c: Comparison, one: Compared, best: Compared) -> dict[str, Any]:
    found = {
        "name": one.name,
        "kind": one.kind,
        **errors(one.forecasts),
        "gains": {name: asdict(value) for name, value in one.gain.items()},
        "collective": {name: {"mean": mean, "std": std} for name, (mean, std) in one.collective.items()},
    }
    if one.kind == "simulated":
        return {**found, "heldout_gain_nats": None, "heldout_gain_se": None, "behind": None, "drivers": []}
    won = np.nansum(one.forecasts.one_step, axis=1)
    ends = _of_each(one.forecasts.single.error[:, -1])
    return {
        **found,
        "heldout_gain_nats": one.gain["all"].nats,
        "heldout_gain_se": one.gain["all"].se,
        "behind": asdict(gains(c.data, best.forecasts, one.forecasts)["all"]),
        "drivers": [
            {**name.document(), "log_likelihood": float(won[i]), "single_car_10s_m": ends[i]}
            for i, name in enumerate(c.vicinity.names)
        ],
    }
