"""All words of a diagnosis, a comparison and a critic, out of numbers: what is missing, how sure, what to do."""

from collections.abc import Collection, Sequence
from functools import partial

from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.page.checks import (
    check_in_words,
    check_title,
    checks_hold,
    failed,
    reasons,
    standstill,
)
from sugiyama_ros.page.names import (
    CLEAR,
    MODELS,
    UNITS,
    Document,
    addition,
    chance,
    column_name,
    distances,
    form_of,
    gained,
    listed,
    meaning_of,
    model_name,
    models,
    named,
    nats,
    not_found,
    quantity,
    spaced,
    title_of,
    worse_columns,
)
from sugiyama_ros.page.tables import ranked
from sugiyama_ros.results import figure

# A single-car error of a driver that grows by this factor is told.
_WORSE = 1.2
# Additions that the headline names, of more it says the number; bins or columns, and strengths, that a sentence lists.
_FEW, _WORST, _SHOWN = 3, 3, 5
_BASE = "a = abar(gap, v, v_lead; v*, kappa_v)"


# What was added


def _explains(n: Document) -> bool:
    """Whether an addition has a physical name and is supported. Constants, noises and forces explain nothing."""
    return n["kind"] in ("effect", "measurement") and bool(n["is_supported"])


def size_of(d: Document, n: Document) -> str:
    """The size of an addition: each parameter with its meaning, its standard error and its unit."""
    values = n.get("parameters", {})
    if n.get("covariate"):
        force = [float(value) for name, value in values.items() if name.startswith("force_")]
        unit = UNITS.get(str(n["covariate"]), "")
        first, last = (quantity(float(values[end]), unit if end == "last" else "") for end in ("first", "last"))
        size = f"{quantity(min(force), digits=2)} to {quantity(max(force), 'm/s²', digits=2)}"
        return f"{size} along the {spaced(n['covariate'])}, from {first} to {last}"
    meanings, stds = d.get("about", {}).get(form_of(n), {}).get("parameters", {}), n.get("parameters_std", {})
    parts = []
    for name in sorted(values, key=[*meanings, *values].index):
        meaning = meanings.get(name, {})
        size = quantity(float(values[name]), str(meaning.get("unit", "")), stds.get(name))
        parts.append(f"{meaning_of(meaning, name)}: {size}")
    return "; ".join(parts) or "a value of each driver"


def on_unseen(d: Document, n: Document) -> str:
    """What an addition gains on data that no fit has seen, and for whom."""
    gain, se = float(n["heldout_gain_nats"]), float(n["heldout_gain_se"])
    text = f"{nats(gain, se)} nats"
    if gain > 0.0 and se > 0.0:
        text += f" better ({gain / se:.1f} standard errors)"
    if gain <= CLEAR * se and (best := _clearest(n)):
        text += f", most clearly {best}"
    shown_by = [_number(one) for one in d["drivers"] if one["vehicle"] in n["vehicles"]]
    return text + (f"; shown by {_vehicles(shown_by)} only" if shown_by else "")


def _clearest(n: Document) -> str:
    """The column in which an addition gains most standard errors, if it gains clearly there."""
    columns = {name: one for name, one in n["gains"].items() if name != "all" and one["se"] > 0.0}
    name = max(columns, key=lambda name: columns[name]["nats"] / columns[name]["se"], default="")
    if not name or columns[name]["nats"] <= CLEAR * columns[name]["se"]:
        return ""
    return f"{column_name(name)}: {gained(columns[name])}"


def worse_in_words(n: Document) -> str:
    """Every forecast that an addition makes worse; empty if it makes none worse."""
    clear, others = (worse_columns(n["gains"], clearly=one) for one in (True, False))
    return "; ".join([*clear, *([f"within chance: {', '.join(others)}"] if others else [])])


def _certainty(d: Document, n: Document) -> str:
    """How certain an addition is: its gain on data that no fit has seen, and its p-value."""
    if n["is_supported"]:
        return f"unseen data confirm it: {on_unseen(d, n)}; chance gains as much with {chance(n['p_value'])}"
    return not_found(n) or f"{not_asked_for(n)}; on unseen data {on_unseen(d, n)}"


def not_asked_for(n: Document) -> str:
    """Says that the data do not ask for an addition, and why."""
    gains = float(n["heldout_gain_nats"]) > CLEAR * float(n["heldout_gain_se"])
    why = {
        "score": f"its score before the fit does not stand out from what chance gives ({chance(n['p_value'])})"
        + (", although the fit gains" if gains else ""),
        "gain": "unseen data are not forecast clearly better",
        "worse": "some forecasts get worse",
    }
    reasons = [why[name] for name in n["doubts"]]
    return "the data do not ask for it" + (f": {listed(reasons)}" if reasons else "")


def gain_in_words(d: Document, n: Document) -> str:
    """The name of an addition, and what it gains on unseen data, in a few words."""
    size = f"{nats(float(n['heldout_gain_nats']), float(n['heldout_gain_se']))} nats"
    told = f"{size} better on unseen data" if n["is_supported"] else not_found(n) or f"{size}; {not_asked_for(n)}"
    return f"{addition(d, n)}: {told}"


def not_told_apart(d: Document, n: Document) -> str:
    """What an addition cannot be told apart from; empty if it can be told apart from everything that was fitted."""
    return listed([named(d, other) for other in n["indistinguishable"]], "or")


def closest(d: Document, n: Document) -> str:
    """The physical effect that comes closest to an addition that has no physical name; empty if there is none."""
    one = n["closest_effect"]
    if not one:
        return ""
    name, behind, se = named(d, one["name"]), float(one["behind_nats"]), float(one["behind_se"])
    if behind >= 0.0:
        return f"the physical effect that comes closest, {name}, is {nats(behind, se)} nats behind"
    why = "some forecasts get worse, or its values make no physical sense"
    return f"{name} gains {nats(-behind, se)} nats more, but cannot be added: {why}"


def equation(d: Document) -> str:
    """The model as an equation, with what is new in brackets, and the values; empty if nothing was added."""
    sums, rules, values = "", [], []
    every = [k for n in d["verdict"]["effects"] for k in n.get("parameters", {})]
    for n in d["verdict"]["effects"]:
        about = d.get("about", {}).get(form_of(n), {})
        known, stds = n.get("parameters", {}), n.get("parameters_std", {})
        term = str(about.get("term") or "").replace("covariate", str(n.get("covariate")))
        if term.startswith(("+", "-")):
            sums += f" [{term}]"
        else:
            rules.append(f"[{term or _unwritten(n)}]")
        units = {name: str(one.get("unit", "")) for name, one in about.get("parameters", {}).items()}
        shown = known if not n.get("covariate") else {}
        values += [
            f"{k if every.count(k) == 1 else f'{form_of(n)}.{k}'} = {quantity(float(v), units.get(k, ''), stds.get(k))}"
            for k, v in shown.items()
        ]
    law = str(d.get("law") or PAPERS)
    base = _BASE if law == PAPERS else f"a = {model_name(law)}(gap, v, v_lead)"
    added = "; ".join([f"{base}{sums}", *rules])
    return ", ".join([added, *values]) if d["verdict"]["effects"] else ""


def _unwritten(n: Document) -> str:
    """What stands in the equation for constants that are free, and for an effect that declares no term."""
    names = ", ".join(n.get("parameters", {}))
    if n["kind"] in ("constants", "noise"):
        return f"{names} free" if names else f"{form_of(n)} of each driver free"
    return f"{form_of(n)}({names})"


# The verdict


def badge(d: Document) -> tuple[str, str]:
    """The outcome of a verdict: a sign, and words."""
    outcome, effects = d["verdict"].get("outcome", ""), d["verdict"]["effects"]
    if effects and not any(n["is_supported"] for n in effects) and not failed(d):
        return "?", "Added as asked; the data do not ask for it"
    if outcome == "adequate":
        return "✓", "The model is adequate"
    if outcome == "explained" and any(map(_explains, effects)):
        return "✓", "What was missing is explained"
    return "✗", "Not explained"


def headline(d: Document) -> str:
    """The verdict as a few plain sentences; physics, constants and forces are told apart."""
    sign, words = badge(d)
    stands, said = standstill(d), _findings(d)
    return said if sign == "?" else f"{words}: {stands}{capital(said) if stands else said}"


def _findings(d: Document) -> str:
    effects = d["verdict"]["effects"]
    fails = f"fails {len(failed(d))} of {len(d['checks'])} checks"
    if not effects:
        if d["verdict"]["outcome"] == "adequate":
            return "no check fails."
        return f"the model {fails}, and no effect that was tried explains it."
    supported = [n for n in effects if n["is_supported"]]
    if not supported:
        asked = f"You asked for {_of(d, effects)}; the data do not."
        return f"{asked} The model {fails}: something else is missing." if failed(d) else asked
    still = f" The model still {fails}." if failed(d) else ""
    physical, rest = ([n for n in supported if _explains(n) == is_physical] for is_physical in (True, False))
    if not physical:
        return f"{_without_physics(d, rest)}{still}"
    more = f" Besides, {_without_physics(d, rest)}" if rest else ""
    names, is_one = _of(d, physical, "physical effects"), len(physical) == 1
    if still:
        return f"{names} {'is' if is_one else 'are'} missing, and so is something else.{more}{still}"
    tried = " Other effects were not fitted." if d["verdict"].get("asked") else ""
    return f"{names}. With {'it' if is_one else 'them'}, no check fails.{tried}{more}"


def _of(d: Document, effects: Sequence[Document], kind: str = "additions") -> str:
    """The names of few additions, or the number of many."""
    return listed([addition(d, n) for n in effects]) if len(effects) <= _FEW else f"{len(effects)} {kind}"


def _without_physics(d: Document, effects: Sequence[Document]) -> str:
    """What additions without a physical name mean, and the physical effect that comes closest."""
    says = {
        "force": "a force helps that has no name",
        "constants": "these drivers do not have the paper's constants",
        "noise": "these drivers do not have the model's noises",
    }
    mine = {kind: [n for n in effects if n["kind"] == kind] for kind in says}
    parts = [f"{words}: {_of(d, mine[kind])}" for kind, words in says.items() if mine[kind]]
    near = next((text for n in effects if (text := closest(d, n))), "")
    return "; ".join([*parts, *([near] if near else [])]) + "."


def how_sure(d: Document) -> str:
    """How certain the names are, in one sentence."""
    effects = d["verdict"]["effects"]
    if not effects:
        return f"{checks_hold(d)}; the model is biased in {biased(d, 'before')}."
    if d["verdict"].get("asked"):
        told = _certainty(d, effects[0]) + "; other" if len(effects) == 1 else "Other"
        return f"{told} effects were not fitted, so nothing is known of what explains the data as well."
    if len(effects) == 1:
        others = not_told_apart(d, effects[0])
        return _certainty(d, effects[0]) + (f"; cannot be told apart from {others}." if others else ".")
    certain = [n for n in effects if not n["indistinguishable"]]
    if len(certain) == len(effects):
        return "Each name can be told apart from everything else that was fitted."
    if certain:
        return f"Only {_of(d, certain)} can be told apart from everything else that was fitted."
    return "No name is certain: these data cannot tell any of them apart from something else."


def worse(d: Document) -> list[str]:
    """What gets worse with the additions: for which drivers, and in which forecasts."""
    effects = d["verdict"]["effects"]
    if not effects:
        return []
    found = []
    ends = [(one, *(one[f"single_car_10s_{when}_m"] for when in ("before", "after"))) for one in d["drivers"]]
    known = [(one, b, a) for one, b, a in ends if None not in (b, a)]
    names = [_number(one) for one, b, a in known if a > _WORSE * b]
    if names:
        drivers = f"{len(names)} of {len(known)} drivers ({_vehicles(names)})"
        found.append(f"for {drivers}, one-car free runs get more than a fifth worse")
    return found + cautions(d)


def cautions(d: Document) -> list[str]:
    """What a user of the final model must know: forecasts that are clearly worse than those of the base model."""
    columns = worse_columns(d["errors"].get("after", {}).get("gains", {}))
    more = f", and {len(columns) - _WORST} more" if len(columns) > _WORST else ""
    return [f"forecasts get worse than the base model's: {'; '.join(columns[:_WORST])}{more}"] if columns else []


def fall(d: Document) -> str:
    """How the error after 10 s falls, and by what kind of additions; empty where it is not known."""
    ends = [end for when in MODELS[:2] if (end := _after_10_s(d["errors"].get(when, {}))) is not None]
    shares = d["verdict"].get("fall")
    if not d["verdict"]["effects"] or len(ends) < 2 or not shares:
        return ""
    before, after = distances(*ends)
    if ends[1] >= ends[0]:
        return f"The error of a forecast over 10 s does not fall: {before} -> {after}."
    physics, other = float(shares["physics_m"]), float(shares["other_m"])
    by = f"{'all' if not other else 'none' if physics <= 0.0 else ''} of it by physical effects"
    if physics > 0.0 and other:
        taken, rest = distances(physics, abs(other))
        all_else = f"all else that was added {'takes off' if other > 0.0 else 'adds'} {rest}"
        by = f"physical effects take off {taken}, {all_else}"
    return f"The error of a forecast over 10 s falls, {before} -> {after}: {by}."


def _after_10_s(errors: Document) -> float | None:
    """Error after 10 s: of all cars together, or of single cars on tracks."""
    known = (errors.get(f"{run}_10s_m") for run in ("free_run", "single_car"))
    return next((float(one) for one in known if one is not None), None)


def what_to_do(d: Document) -> str:
    """What to do after the verdict: the strongest lead first."""
    effects = d["verdict"]["effects"]
    advice = list(dict.fromkeys(text for n in effects for text in n["advice"]))
    left = failed(d)
    if left:
        lead = f"Look first at the strongest failed check, {check_title(d, left[0])}."
        names = " Do not take the names for causes." if effects else ""
        return f"{lead}{names}{_tell_apart(advice)}{_best_predictor(d)}"
    if not effects:
        small = "The table of what these data would have shown says how small a missing effect may be."
        return f"Use the model as it is. {small}"
    if not any(n["is_supported"] for n in effects):
        return "Leave it out, unless you know from elsewhere that the drivers have it."
    if advice:
        return _tell_apart(advice).strip()
    if not any(map(_explains, effects)):
        return f"Do not take it for a cause. {_use(d)}"
    return _use(d)


def _tell_apart(advice: Sequence[str]) -> str:
    return f" To tell apart what cannot be told apart, {'; '.join(advice)}." if advice else ""


def _use(d: Document) -> str:
    """How to use the model with what was added."""
    if model := d.get("model_file"):
        return f"Use the model with it: give --model {model} to sugiyama run, live, simulate or compare."
    command = d.get("command") or "sugiyama diagnose FILE"
    then = "then give --model model.yaml to sugiyama run, live, simulate or compare."
    return f"Keep the model with it: {command} -o model.yaml; {then}"


def _best_predictor(d: Document) -> str:
    """Which law to use where prediction counts, if another law forecasts clearly better than the final model."""
    shown = models(d)
    won = {name: float(one["gains"]["all"]["nats"]) for name, one in shown.items() if one.get("gains")}
    best = max(won, key=lambda name: won[name], default="before")
    if best in MODELS or f"gain_of_{best}" not in {one["name"] for one in failed(d)}:
        return ""
    return f" {model_name(best)} forecasts these data better; use it where only prediction counts."


def would_have_shown(d: Document) -> list[tuple[str, str]]:
    """Effects that are not in the data, and how strong each would have to be to have usually shown."""
    found = []
    for one in d.get("smallest_detectable", ()):
        if not one["value"]:
            continue
        about = d.get("about", {}).get(one["name"], {})
        declared = about.get("parameters", {}).get(one["parameter"], {})
        value, unit = float(one["value"]), str(declared.get("unit", ""))
        # a smaller limit is a stronger effect
        end = "or less" if about.get("is_limit") else "or more"
        size = f"{quantity(value, unit, digits=2)} {end if value > 0.0 else 'or beyond'}"
        found.append((title_of(d, one["name"]), f"{meaning_of(declared, one['parameter'])}: {size}"))
    return found


# What the command line prints


def sentences(d: Document) -> list[str]:
    """Return the verdict in words, one line for each finding, the strongest first."""
    effects = d["verdict"]["effects"]
    lines = [headline(d), fall(d)]
    if not effects:
        shown = [f"{title} ({size})" for title, size in would_have_shown(d)]
        more = f", and {len(shown) - _SHOWN} more (in the report and in --json)" if len(shown) > _SHOWN else ""
        sizes = ", ".join(shown[:_SHOWN]) + more
        lines.append(f"Effects of this strength would usually have shown: {sizes}." if shown else "")
    for n in sorted([*effects, *d["verdict"]["dropped"]], key=lambda n: int(n["step"])):
        lines += [_taken_out(d, n)] if "dropped_in" in n else _added(d, n, lines[0])
    model = equation(d)
    lines.append(f"The model, with what is new in brackets: {model}" if model else "")
    lines += [f"Fails: {one}." for one in reasons(d)]
    lines.append(f"{checks_hold(d)}." if d["checks"] else "")
    ahead = [one for one in d["checks"] if one["name"].startswith("gain_of_") and float(one["value"]) > 0.0]
    lines += [f"{capital(check_in_words(d, one))}: it may be ahead by chance." for one in ahead if not one["failed"]]
    lines += [f"{capital(one)}." for one in worse(d)]
    for when, of in (("before", "The base model"), ("after", "The model with the additions")):
        if when in d.get("where", {}) and (effects or when == "before"):
            lines.append(f"{of} is biased in {biased(d, when)}.")
    return [line for line in [*lines, *_data(d)] if line]


def _added(d: Document, n: Document, told: str) -> list[str]:
    """Lines about an addition; ``told``: what the first line says already."""
    seen = f"On unseen data {on_unseen(d, n)}; {chance(n['p_value'])}{_step_in_words(n)}"
    lines = [f"{addition(d, n)}: {size_of(d, n)}. {seen}."]
    if d["verdict"].get("asked"):
        lines.append("The data ask for it." if n["is_supported"] else f"You asked for it; {not_asked_for(n)}.")
    if text := worse_in_words(n):
        lines.append(f"Gets worse: {text}.")
    if others := not_told_apart(d, n):
        advice = f" To tell them apart, {'; '.join(n['advice'])}." if n["advice"] else ""
        lines.append(f"It cannot be told apart from {others}.{advice}")
    if (near := closest(d, n)) and near not in told:
        lines.append(f"{capital(near)}.")
    return [lines[0], *(f"  {line}" for line in lines[1:])]


def _step_in_words(n: Document) -> str:
    """How the error after 10 s changes in a step; empty where it is not known."""
    ends = [n["free_run_rmse_before_m"], n["free_run_rmse_after_m"]]
    return f"; error after 10 s {' -> '.join(distances(*ends))}" if None not in ends else ""


def _taken_out(d: Document, n: Document) -> str:
    """A line about something that was added and then taken out again, so that the errors of the steps have no gap."""
    steps = [*d["verdict"]["effects"], *d["verdict"]["dropped"]]
    beside = listed([addition(d, one) for one in steps if one["step"] == n["dropped_in"]])
    return f"{addition(d, n)}: added{_step_in_words(n)}; taken out again, because it is not needed beside {beside}."


def biased(d: Document, when: str) -> str:
    """In how many bins a model is biased, and where most of all."""
    where = d.get("where", {}).get(when, {"flagged": [], "bins": []})
    worst = "; ".join(map(_bin_in_words, where["flagged"][:_WORST]))
    return f"{len(where['flagged'])} of {len(where['bins'])} bins" + (f", most of all: {worst}" if worst else "")


def _bin_in_words(b: Document) -> str:
    """A bin, and the bias in it."""
    name = "while" if b["covariate"] == "regime" else spaced(b["covariate"])
    value = b["label"] or f"{figure(b['low'])} to {figure(b['high'])} {UNITS.get(b['covariate'], '')}".strip()
    return f"{name} {value} ({b['bias']:+.2f} std)"


def _data(d: Document) -> list[str]:
    """What was done with the recording: smoothing, decisions between samples, other noises, drivers left out."""
    lines = []
    smoothed_s, apart_s = float(d.get("smoothed_s") or 0.0), float(d.get("counted_every_s") or 0.0)
    period_s, decisions = float(d.get("decision_period_s") or 1.0), int(d.get("decisions_per_sample") or 1)
    why = "Positions move more evenly than the model's noises let them"
    if smoothed_s:
        why = f"Third differences of the positions are correlated over about {smoothed_s:.2g} s, as by a smoother"
    if round(apart_s / period_s) > decisions:
        lines.append(f"{why}: only samples that are {apart_s:.2g} s apart count.")
    elif smoothed_s:
        lines.append(f"{why}: the ends of each record do not count.")
    if d.get("has_other_noises"):
        lines.append("The paper's noises of position and speed do not suit these vehicles: they are fitted for each.")
    if decisions > 1:
        lines.append(
            f"Samples are {apart_s:.2g} s apart; the model's drivers decide {decisions} times from one to the next,"
            f" every {period_s:.2g} s."
        )
    if d.get("drivers_left_out"):
        lines.append(left_out(int(d["drivers_left_out"]), int(d["vehicles"])))
    if d.get("drivers_searched", d["vehicles"]) < d["vehicles"]:
        judged = "; what was found is fitted to all drivers, and judged by all" * bool(d["verdict"]["effects"])
        some = f"{d['drivers_searched']} of {d['vehicles']}"
        lines.append(f"Searched on {some} drivers, evenly spread over the recording{judged}.")
    missed = [] if d["verdict"].get("asked") else d["verdict"].get("not_searched")
    if missed and d["errors"]["before"].get("free_run_10s_m") is None:
        reasons = [f"{named(d, one['name'])}: {one['reason']}" for one in missed]
        lines.append(f"Not searched for: {'; '.join(reasons)}.")
    return lines


def left_out(number: int, drivers: int) -> str:
    """A sentence about drivers who were left out."""
    return (
        f"This is about {drivers} of {drivers + number} drivers, evenly spread over the recording: all of them would"
        " take too much memory."
    )


# Comparisons


def best_model(c: Document) -> str:
    """Which model of a comparison forecasts best, and which ones cannot be told apart from it; none in sample."""
    own = [model_name(one["name"]) for one in c["models"] if one["kind"] == "in_sample"]
    before = f"{own[0]} was fitted to these samples, so it does not count here. " if own else ""
    best, *others = ranked(c)
    if best["kind"] == "base":
        second = f"; {_behind(others[0])}" if others else ""
        return f"{before}No other model forecasts unseen data better than the base model{second}."
    gain = f"{nats(best['heldout_gain_nats'], best['heldout_gain_se'])} nats better than the base model"
    text = f"{before}{model_name(best['name'])} forecasts unseen data best, {gain}"
    alike = [model_name(one["name"]) for one in others if one["behind"]["nats"] <= CLEAR * one["behind"]["se"]]
    if alike:
        return f"{text}. It cannot be told apart from {listed(alike, 'or')}."
    return f"{text}; {_behind(others[0])}." if others[0]["kind"] != "base" else f"{text}."


def use_of_file(c: Document, file: str) -> str | None:
    """How the model of a file was used on a recording that it was not fitted to; None without such a file."""
    given = c["given"]
    if given is None:
        return None
    text = (
        f"{file}: what it says of the road and of all drivers is taken as it is; {listed(given['fitted'])} of each"
        " driver are fitted to this recording, as the base model's are"
    )
    if given["left_out"]:
        text += f"; left out, tied to a moment of its own recording: {listed(given['left_out'])}"
    period_s = given["decision_period_s"]
    if period_s is not None and abs(period_s - c["decision_period_s"]) > 0.01 * period_s:
        text += f"; its drivers decide every {period_s:.2g} s, here every {c['decision_period_s']:.2g} s"
    return text


def start_of_drivers(file: str, is_own: bool | None, left_out: Sequence[str]) -> str:
    """How the drivers of a run start from a model file: by their own parameters, or as its typical driver."""
    if is_own is None:
        return f"{file}: each driver starts as the driver of this number in the file"
    if is_own:
        return f"{file} was fitted to this recording: each driver starts from their own parameters"
    text = f"{file} was fitted to another recording: each driver starts as its typical driver, and is estimated here"
    return text + (f"; left out, tied to a moment of its own recording: {listed([*left_out])}" if left_out else "")


def _behind(one: Document) -> str:
    return f"{model_name(one['name'])} is {gained(one['behind'])} nats behind"


# Critics

#: Why a critic may say something else than a diagnosis.
WHY = (
    "the critic hears each sample once, adds one effect at a time out of those that it knows, and holds no data out;"
    " a diagnosis compares all effects on data that no fit has seen"
)

# A lead over the base model [nats] that chance and the filter's approximations may bring.
_CHANCE_NATS = 10.0


def may_be_chance(best: str, lead: float) -> bool:
    """Return whether chance may bring the lead [nats] of a model over the base model."""
    return best != "base" and lead < _CHANCE_NATS


def beside_the_verdict(d: Document | None, best: str, added: Collection[str], lead: float = float("inf")) -> str:
    """Say what a critic prefers at the end, ``base`` or an effect, and whether the verdict of a diagnosis agrees."""
    words = partial(title_of, d or {})
    had = f", beyond what the estimators had already ({', '.join(map(words, added))})" if added else ""
    text = f"The critic of this run finds {'nothing' if best == 'base' else words(best)} missing{had}."
    if may_be_chance(best, lead):
        by_chance = f"{words(best)} leads by {lead:.0f} nats, which may be chance"
        text = f"The critic of this run finds nothing clearly missing{had}: {by_chance}."
        best = "base"
    if d is None:
        return f"{text} This is no verdict: {WHY}."
    effects = {str(n["name"]): n["indistinguishable"] for n in d["verdict"]["effects"]}
    missing = [name for name in effects if name not in added]
    if best in missing or (best == "base" and not missing):
        return f"{text} The verdict above says the same."
    alike = [name for name in missing if best in effects[name]]
    if alike:
        return f"{text} The verdict above cannot tell it apart from {words(alike[0])}."
    return f"{text} The verdict above is another one, and it counts: {WHY}."


# Lists


def capital(text: str) -> str:
    """A text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def _number(driver: Document) -> str:
    """The number of a vehicle as the pictures have it, with its name in the recording where that differs."""
    number, name = str(driver["vehicle"]), str(driver.get("name", ""))
    return f"{number} ({name})" if name not in ("", number) else number


def _vehicles(names: list[str]) -> str:
    return f"vehicle{'s' if len(names) > 1 else ''} {listed(names)}"
