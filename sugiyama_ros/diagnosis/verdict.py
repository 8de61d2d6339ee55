"""A diagnosis as a document (for ``--json``) and as sentences."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from sugiyama_ros.diagnosis.addition import Addition, parameters_of
from sugiyama_ros.diagnosis.adequacy import LEVEL_OF_BINS, Adequacy, told, who
from sugiyama_ros.diagnosis.candidates import not_searched
from sugiyama_ros.diagnosis.diagnosis import Diagnosis
from sugiyama_ros.diagnosis.discover import FORCE
from sugiyama_ros.diagnosis.locate import Bin, Located
from sugiyama_ros.diagnosis.pictures import about, drives
from sugiyama_ros.diagnosis.use import drivers_worse
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.registry import EFFECTS, ROW, effect
from sugiyama_ros.fit.model_file import own_stds
from sugiyama_ros.fit.recording import Recorded, told_of
from sugiyama_ros.tables import figure

#: Member of the set of what cannot be told apart, where the named effect leaves biases that it should not leave.
UNLISTED = "something that is not listed"
# Maximum number of bins that the sentences mention.
_WORST = 3
# Strengths that would have shown, in words.
_SHOWN = 5


def document(d: Diagnosis) -> dict[str, Any]:
    """Return everything that a diagnosis has found, in plain types and SI units."""
    return {
        "verdict": {
            "adequacy": _judged(d.adequacy),
            "effects": [_named(n, d) for n in d.named],
            "told": sentences(d),
            "searched": list(d.searched),
            "asked": list(d.asked),
            "not_searched": [{"name": name, "reason": reason} for name, reason in not_searched(d.data).items()],
            "refused": [{"name": name, "reasons": list(why)} for name, why in d.refused],
            "none_detectable": not d.named,
            "closer_laws": d.closer,
            "discovered": [
                {
                    "covariate": one.covariate,
                    "ago_s": one.ago_s,
                    "indistinguishable": list(one.alike),
                    "strength": one.strength,
                    "p_value": one.p_value,
                    "gain_nats": one.gain_nats,
                    "knots": list(one.knots),
                    "force": list(one.force),
                }
                for one in d.discovered
            ],
        },
        "candidates": _candidates(d),
        "where": {"before": _where(d.where_before), "after": _where(d.where_after)},
        "smallest_detectable": [
            {"name": name, "parameter": effect(name).parameters[0].name, "value": value}
            for name, value in d.smallest.items()
        ],
        "errors": {"before": d.before.summary(), "after": d.after.summary(), **d.rivals, **d.floor},
        "drivers": _drivers(d),
        "free_run": drives(d),
        "about": about(),
        "data": {"source": d.data.vicinity.source, "sha256": d.data.vicinity.sha256},
        "vehicles": d.data.drivers,
        "drivers_left_out": d.data.left_out,
        "decision_period_s": d.data.vicinity.period_s,
        "samples": d.data.measured_samples if d.data.vicinity.is_whole_road else int(d.data.scored.sum()),
        "bootstrap_runs": d.bootstrap_runs,
        "refitted": d.refitted,
        "quick": d.quick,
        "seed": d.seed,
        "wall_s": d.wall_s,
    }


def _candidates(d: Diagnosis) -> list[dict[str, Any]]:
    """The candidates of the first round by their held-out gains, then those that promised too little to be fitted."""
    fitted = [one for one in d.scored if one.candidate.name in d.heldout]
    found = [
        {
            "name": one.candidate.name,
            "kind": one.candidate.kind,
            "parameters": parameters_of(one.fit, one.candidate),
            "heldout_gain_nats": d.heldout[one.candidate.name].nats,
            "heldout_gain_se": d.heldout[one.candidate.name].se,
            "gain_nats": one.gain,
            "p_value": one.p_value,
        }
        for one in sorted(fitted, key=lambda one: -d.heldout[one.candidate.name].nats)
    ]
    unknown = dict.fromkeys(("heldout_gain_nats", "heldout_gain_se"))
    return found + [
        {"name": c.name, "kind": c.kind, "parameters": {}, "gain_nats": gain, "p_value": p, **unknown}
        for c, gain, p in sorted(d.left_out, key=lambda one: -one.gain)
    ]


def _judged(adequacy: Adequacy) -> dict[str, Any]:
    found = {**asdict(adequacy), "reasons": list(adequacy.reasons)}
    del found["bins_p_value"]  # in the fresh check of each effect
    return found


def is_open(d: Diagnosis) -> bool:
    """Whether recordings that the final model simulates would not leave the biases that are left in the data."""
    return d.adequacy.bins_p_value is not None and d.adequacy.bins_p_value < LEVEL_OF_BINS


def errors_of_parameters(n: Addition, d: Diagnosis) -> dict[str, float]:
    """Return the standard errors of an addition's shared parameters in the final model, by name."""
    keys = {name: (f"{n.form}.{name}", name) for name in n.parameters}
    return {name: d.stds[key] for name, pair in keys.items() for key in pair if key in d.stds}


def _named(n: Addition, d: Diagnosis) -> dict[str, Any]:
    return {
        "name": n.name,
        "form": n.form,
        "kind": n.kind,
        "parameters": n.parameters,
        "parameters_std": errors_of_parameters(n, d),
        "indistinguishable": [*n.indistinguishable, *([UNLISTED] if is_open(d) else [])],
        "advice": list(n.advice),
        "who": who(n, d.data.vicinity.numbers),
        "explained_share": d.adequacy.explained_share,
        "fresh_check": {
            "bins_flagged": d.adequacy.bins_flagged,
            "bins_expected": d.adequacy.bins_expected,
            "p_value": d.adequacy.bins_p_value,
            "holds": not is_open(d),
        },
        "worse_where": list(n.worse),
        "is_supported": n.is_supported,
        "covariate": COVARIATES[round(n.parameters["covariate"]) - 1] if n.name == FORCE else None,
        "p_value": n.p_value,
        "heldout_gain_nats": n.heldout.nats,
        "heldout_gain_se": n.heldout.se,
        "free_run_rmse_before_m": n.before.free_run_10s_m,
        "free_run_rmse_after_m": n.after.free_run_10s_m,
    }


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
    before, after = d.before.by_driver(), d.after.by_driver()
    own, stds = d.final.model.rows, own_stds(d.final)
    return [
        {
            **name.document(),
            "heldout_gain_nats": a[0] - b[0],
            "single_car_10s_before_m": b[1],
            "single_car_10s_after_m": a[1],
            "v_star": float(row[V_STAR]),
            "v_star_std": std.get("v_star"),
            "kappa_v": float(row[KAPPA_V]),
            "kappa_v_std": std.get("kappa_v"),
        }
        for name, b, a, row, std in zip(d.data.vicinity.names, before, after, own, stds, strict=True)
    ]


def _told(b: Bin) -> str:
    return f"{b.shown} ({b.bias:+.2f} std)"


def _quantity(value: float, unit: str, std: float | None = None) -> str:
    """A value with its standard error, if it has one, and its unit; a pure number has none."""
    known = f" ± {figure(std, 2)}" if std is not None and np.isfinite(std) and std > 0.0 else ""
    return f"{figure(value)}{known}" if unit in ("", "1") else f"{figure(value)}{known} {unit}"


def _values(n: Addition, stds: Mapping[str, float]) -> str:
    """The parameters of an addition, with standard errors and units."""
    units = {p.name: p.unit for p in EFFECTS[n.form].parameters} if n.form in EFFECTS else {}
    units |= {p.name: p.unit for p in ROW.declared if p.name in n.parameters and p.name not in units}
    return ", ".join(f"{k} {_quantity(v, units.get(k, ''), stds.get(k))}" for k, v in n.parameters.items())


def _not_certain(d: Diagnosis) -> list[str]:
    """Return one sentence on what the additions cannot be told apart from, and one on what would tell them apart."""
    others = [f"{n.name} from {', '.join(n.indistinguishable)}" for n in d.named if n.indistinguishable]
    if d.named and is_open(d):
        others.append(f"{'all' if len(d.named) > 1 else d.named[0].name} from {UNLISTED}")
    advice = dict.fromkeys(one for n in d.named for one in n.advice)
    lines = [f"Cannot be told apart: {'; '.join(others)}."] if others else []
    return lines + ([f"To tell them apart: {'; '.join(advice)}."] if advice else [])


def _asked_for(n: Addition) -> str:
    """Return one sentence on whether the data ask for what somebody has asked to add."""
    if n.is_supported:
        return "The data ask for it."
    if n.p_value <= 0.05 and n.heldout.nats > 0.0:
        return "It was added because you asked for it; held out, it gains too little to count."
    return "It was added because you asked for it; the data do not ask for it."


def force_in_words(values: Mapping[str, float]) -> str:
    """Return what a force without a name depends on, and how large it is."""
    covariate = COVARIATES[round(values["covariate"]) - 1]
    force = [value for name, value in values.items() if name.startswith("force_")]
    return (
        f"{covariate} from {figure(values['first'])} to {figure(values['last'])}: {figure(min(force), 2)} to"
        f" {figure(max(force), 2)} m/s^2"
    )


def _smoothing(data: Recorded) -> str:
    """Return one sentence on which samples count of smoothed positions; an empty string for others."""
    why = "Positions move more evenly than the model's noises let them"
    if data.smoothed_s:
        why = f"Third differences of the positions are correlated over about {data.smoothed_s:.2g} s, as by a smoother"
    if data.every > data.decisions:
        return f"{why}: only samples that are {data.apart_s:.2g} s apart count."
    return f"{why}: the ends of each record do not count." if data.smoothed_s else ""


def _noises(data: Recorded) -> str:
    """Return one sentence on noises that do not suit the recording; an empty string if they do."""
    if not data.even.has_other_noises:
        return ""
    return "The paper's noises of position and speed do not suit these vehicles: they are fitted for each driver."


def _decisions(data: Recorded) -> str:
    """Return one sentence on how often the model's drivers decide; an empty string if they do at each sample."""
    if data.decisions == 1:
        return ""
    return (
        f"Samples are {data.apart_s:.2g} s apart; the model's drivers decide {data.decisions} times from one to the"
        f" next, every {data.vicinity.period_s:.2g} s."
    )


def sentences(d: Diagnosis) -> list[str]:
    """Return the verdict in words, one line for each finding."""
    lines = [told(d.adequacy)]
    if not d.named:
        failed = d.adequacy.outcome == "not_explained"
        lines.append(
            "Nothing in the catalogue explains it."
            if failed
            else "Nothing that is missing can be detected in these data."
        )
        shown = [
            f"{name} ({p.name} {_quantity(d.smallest[name], p.unit)})"
            for name in d.smallest
            for p in [effect(name).parameters[0]]
        ]
        more = f", and {len(shown) - _SHOWN} more (in the report and in --json)" if len(shown) > _SHOWN else ""
        listed = ", ".join(shown[:_SHOWN]) + more
        lines.append(f"Effects of this strength would usually have shown: {listed}." if shown else "")
    for n in d.named:
        form = f"as {n.form}: " if n.form != n.name else ""
        values = force_in_words(n.parameters) if n.name == FORCE else _values(n, errors_of_parameters(n, d))
        lines.append(
            f"{n.name} ({form}{values}): held-out gain {n.heldout.nats:.0f} ± {n.heldout.se:.0f} nats,"
            f" p {n.p_value:.1g}; 10-s free run {n.before.free_run_10s_m:.2f} ->"
            f" {n.after.free_run_10s_m:.2f} m."
        )
        if d.asked:
            lines.append(f"  {_asked_for(n)}")
        which = who(n, d.data.vicinity.numbers)
        if which != "all":
            names = ", ".join(map(str, which))
            lines.append(
                f"  Only vehicle {names} shows it." if len(which) == 1 else f"  Only vehicles {names} show it."
            )
    lines += _not_certain(d)
    if d.closer:
        laws = ", ".join(f"those of {name} {figure(error)} m" for name, error in d.closer.items())
        lines.append(f"After 10 s, free runs of the model are {figure(d.after.free_run_10s_m)} m off, {laws}.")
    lines += [f"In use it is worse than the base model: {one}." for n in d.named[-1:] for one in n.worse[:_WORST]]
    lines += [_smoothing(d.data), _noises(d.data), _decisions(d.data)]
    if d.data.left_out:
        lines.append(told_of(d.data.left_out, d.data.drivers))
    left_out = not_searched(d.data)
    if left_out and not d.data.vicinity.is_whole_road:
        lines.append("Not searched: " + ", ".join(f"{name} ({reason})" for name, reason in left_out.items()) + ".")
    lines += [f"{name} was not added: {'; '.join(why)}." for name, why in d.refused]
    worse = drivers_worse(d.before.by_driver(), d.after.by_driver()) if d.named else []
    if worse:
        vehicles = ", ".join(d.data.vicinity.names[i].shown for i in worse)
        lines.append(f"Free runs of these vehicles get worse by more than a fifth: {vehicles}.")
    for located, of in ((d.where_before, "The base model"), (d.where_after, "The model with the additions")):
        if located is d.where_after and not d.named:
            continue
        worst = "; ".join(_told(b) for b in located.flagged[:_WORST])
        count = f"{len(located.flagged)} of {len(located.bins)} bins"
        lines.append(f"{of} is biased in {count}" + (f", most of all at {worst}." if worst else "."))
    return [line for line in lines if line]
