"""A diagnosis in plain words, out of its document: what is missing, how large, how sure, and what to do."""

import math
import re
from collections.abc import Mapping
from typing import Any

from sugiyama_ros.tables import figure

Document = Mapping[str, Any]
_LAWS = {"idm": "IDM", "fvdm": "FVDM", "ovm": "OVM", "gipps": "Gipps", "newell": "Newell", "helly": "Helly"}
# Additions that the card and its headline name one by one; of more, they say the number.
_FEW = 2
# A driver's single-car error has grown clearly, as `sugiyama diagnose` says it.
_WORSE = 1.2
# A gain of fewer standard errors is not clear.
_CLEAR = 2.0
#: Errors [m] below this are told in millimetres.
SMALL_M = 0.01
# Lengths [m] and speeds [m/s] below this are told in millimetres.
_SMALL = 1e-3
# A name of a parameter, an effect or a law.
_IDENTIFIER = r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*"
# Symbols in the meanings of parameters.
_SYMBOLS = {"v*": "the desired speed", "κ_v": "the risk premium", "sigma_a": "the acceleration noise"}
# Outcomes of a verdict: sign and words.
_OUTCOMES = {
    "adequate": ("✓", "The model is adequate"),
    "explained": ("✓", "What was missing is explained"),
    "not_explained": ("✗", "Not explained"),
}


def form_of(n: Document) -> str:
    """Name of the form in which an effect was added: other forms of a mechanism have other parameters and units."""
    return str(n.get("form") or n["name"])


def title_of(d: Document, name: str) -> str:
    """Name for people of an effect, a group of constants or a law, or of the base model of a critic."""
    explained = d.get("about", {}).get(name)
    return str(explained["title"]) if explained else "the base model" if name == "base" else name.replace("_", " ")


def summary_of(d: Document, name: str) -> str:
    """Explanation of a name in one line; empty where the document has none."""
    return str(d.get("about", {}).get(name, {}).get("summary", ""))


def model_name(name: str) -> str:
    """Name of a model in tables and legends."""
    known = {"before": "base model", "after": "with what was added", "floor": "floor (simulated)"}
    if name in known:
        return known[name]
    law = name.removesuffix("_least_squares")
    return _LAWS.get(law, law.replace("_", " ")) + (", fitted to gaps" if law != name else "")


def models(d: Document) -> dict[str, Document]:
    """Errors of the models by name, without a model that equals the base model because nothing was added."""
    return {name: one for name, one in d["errors"].items() if name != "after" or d["verdict"]["effects"]}


def quantity(value: float, unit: str = "", std: float | None = None, digits: int = 3) -> str:
    """A value with its standard deviation and its unit; without a standard deviation, with so many digits."""
    if std is None or not (math.isfinite(std) and std > 0.0):
        if 0.0 < abs(value) < _SMALL and unit in ("m", "m/s"):
            value, unit = 1e3 * value, f"m{unit}"
        text = figure(value, digits)
    else:
        places = min(max(-math.floor(math.log10(std)), 0), 5)
        text = f"{value:.{places}f} ± {std:.{places}f}"
    return f"{text} {unit.replace('^2', '²').replace('^3', '³')}".strip()


def length(value_m: float) -> str:
    """A length [m] with three digits, so that lengths beside each other end alike."""
    return f"{value_m:#.3g}".rstrip(".") if value_m < 1e3 else f"{value_m:.0f}"


def distances(*values_m: float) -> list[str]:
    """Lengths [m] with their unit: millimetres where all are small, as where somebody has smoothed the positions."""
    if any(abs(value) >= SMALL_M for value in values_m):
        return [f"{length(value)} m" for value in values_m]
    return [f"{length(1e3 * value)} mm" for value in values_m]


def would_have_shown(d: Document) -> list[tuple[str, str]]:
    """Effects that are not in the data, and how strong each would have to be to have usually shown."""
    found = []
    for one in d.get("smallest_detectable", ()):
        if not one["value"]:
            continue
        declared = d.get("about", {}).get(one["name"], {}).get("parameters", {}).get(one["parameter"], {})
        meaning = meaning_of(declared, one["parameter"])
        value, unit = float(one["value"]), str(declared.get("unit", ""))
        # a smaller limit is a stronger effect
        end = "or less" if d.get("about", {}).get(one["name"], {}).get("is_limit") else "or more"
        size = f"{quantity(value, unit, digits=2)} {end if value > 0.0 else 'or beyond'}"
        found.append((title_of(d, one["name"]), f"{meaning}: {size}"))
    return found


def plain(d: Document, text: str) -> str:
    """A sentence of the command line, with names for people instead of identifiers."""
    about = d.get("about", {})
    words = re.findall(_IDENTIFIER, text)
    meanings = {
        k: v
        for word in words
        for k, v in about.get(word, {}).get("parameters", {}).items()
        if "_" in k or k[-1].isdigit()
    }
    for name, meaning in meanings.items():
        unit = quantity(0.0, str(meaning.get("unit", "")))[1:]
        text = re.sub(rf"\b({name} is -?\d+(?:\.\d+)?(?:e[+-]?\d+)?)\b", rf"\1{unit}", text)

    def shown(found: re.Match[str]) -> str:
        name = found[0]
        if name in about:
            return model_name(name) if about[name].get("kind") == "law" else title_of(d, name)
        return meaning_of(meanings[name], name) if name in meanings else name.replace("_", " ")

    return re.sub(_IDENTIFIER, shown, text)


def meaning_of(parameter: Document, name: str) -> str:
    """Meaning of a parameter in a few words; what follows a semicolon is where the declaration comes from."""
    words = str(parameter.get("meaning", name.replace("_", " "))).split(";")[0]
    words = re.sub(r"\blog (\S+)", r"the logarithm of \1", words)
    return re.sub("|".join(map(re.escape, _SYMBOLS)), lambda found: _SYMBOLS[found[0]], words)


def size_of(d: Document, effect: Document) -> str:
    """The size of an addition: each parameter with its meaning, its standard deviation and its unit."""
    if effect.get("covariate"):
        return _force(effect)
    meanings = d.get("about", {}).get(form_of(effect), {}).get("parameters", {})
    stds = effect.get("parameters_std", {})
    parts, values = [], effect.get("parameters", {})
    for name in sorted(values, key=[*meanings, *values].index):
        value, meaning = values[name], meanings.get(name, {})
        parts.append(
            f"{meaning_of(meaning, name)}: {quantity(float(value), str(meaning.get('unit', '')), stds.get(name))}"
        )
    return "; ".join(parts)


def _force(effect: Document) -> str:
    """What a force without a name depends on, and how large it is."""
    values = effect["parameters"]
    force = [float(value) for name, value in values.items() if name.startswith("force_")]
    along = str(effect["covariate"]).replace("_", " ")
    ends = [quantity(float(values[end])) for end in ("first", "last")]
    return f"{quantity(min(force))} to {quantity(max(force), 'm/s²')} along the {along}, from {ends[0]} to {ends[1]}"


def chance(p_value: float | None) -> str:
    """A p-value for people."""
    if p_value is None:
        return ""
    return "p < 0.001" if p_value < 1e-3 else f"p {p_value:.2g}"


def badge(d: Document) -> tuple[str, str]:
    """The outcome of a verdict: a sign, and words."""
    outcome, effects = d["verdict"].get("adequacy", {}).get("outcome", ""), d["verdict"]["effects"]
    if effects and not any(map(is_supported, effects)) and outcome != "not_explained":
        return "?", "Added as asked; the data do not ask for it"
    if outcome == "explained" and not any(map(is_confirmed, effects)):
        return "?", "Explained, but not confirmed"
    return _OUTCOMES.get(outcome, ("", "Diagnosis"))


def headline(d: Document) -> str:
    """The verdict as one plain sentence."""
    effects = [title_of(d, form_of(n)) for n in d["verdict"]["effects"]]
    outcome = d["verdict"].get("adequacy", {}).get("outcome")
    found = _and(effects) if len(effects) <= _FEW else f"{len(effects)} additions"
    if not effects:
        if outcome == "not_explained":
            return "The model fails, and nothing in the catalogue explains it."
        if outcome == "adequate":
            return "Nothing that is missing can be detected: nothing in these data speaks against the model as it is."
        return "Nothing that is missing can be detected in these data."
    if not any(map(is_supported, d["verdict"]["effects"])):
        added = f"This was added because you asked for it: {_and(effects)}. These data do not ask for it."
        return f"{added} Something else is missing." if outcome == "not_explained" else added
    if outcome == "not_explained":
        helps = "helps, but does" if len(effects) == 1 else "help, but do"
        return f"The model lacks more than what was found: {found} {helps} not explain these data."
    if not any(map(is_confirmed, d["verdict"]["effects"])):
        return f"The model may lack this: {_and(effects)}. Unseen data do not confirm it."
    end = " With it, nothing in these data speaks against the model." if outcome == "explained" else ""
    return f"The model lacks this: {_and(effects)}.{end}"


def is_supported(n: Document) -> bool:
    """Whether the data ask for an addition; what somebody asks for is added even if they do not."""
    return bool(n.get("is_supported", True))


def is_confirmed(n: Document) -> bool:
    """Whether the gain of an addition on unseen data is above its standard error."""
    return float(n["heldout_gain_nats"]) > float(n["heldout_gain_se"])


def is_clear(n: Document) -> bool:
    """Whether the gain of an addition on unseen data is above two standard errors."""
    return float(n["heldout_gain_nats"]) >= _CLEAR * float(n["heldout_gain_se"])


def certainty(n: Document) -> str:
    """How certain an addition is: its gain on data that no fit has seen, and its p-value on the fitted data."""
    confirm = ("hardly confirm" if not is_clear(n) else "confirm") if is_confirmed(n) else "do not confirm"
    text = f"unseen data {confirm} it: {on_unseen(n)}"
    if p := chance(n.get("p_value")):
        text += f"; on the fitted data, chance gains as much with {p}"
    return text


def on_unseen(n: Document) -> str:
    """What an addition gains on data that no fit has seen, and for whom."""
    gain, se = float(n["heldout_gain_nats"]), float(n["heldout_gain_se"])
    text = f"{gain:.0f} ± {se:.0f} nats"
    if not is_confirmed(n):
        text += ", not above the standard error"
    elif se > 0.0:
        text += f" better ({'' if is_clear(n) else 'only '}{gain / se:.1f} standard errors)"
    if isinstance(who := n.get("who"), list):
        text += f"; shown by {_vehicles([str(v) for v in who])} only"
    return text


def gain_in_words(d: Document, n: Document) -> str:
    """The name of an addition, and what it gains on unseen data, in a few words."""
    size = f"{float(n['heldout_gain_nats']):.0f} ± {float(n['heldout_gain_se']):.0f} nats"
    told = f"{size} better on unseen data" if is_confirmed(n) else f"unseen data do not confirm it ({size})"
    return f"{title_of(d, form_of(n))}: {told}"


def found_in_words(d: Document) -> list[str]:
    """What was added, how large it is and how certain, one line each."""
    return [f"{title_of(d, form_of(n))} ({size_of(d, n)}): {certainty(n)}" for n in d["verdict"]["effects"]]


def not_told_apart(d: Document, n: Document) -> str:
    """What an addition cannot be told apart from; empty if it can be told apart from everything that was searched.

    Nothing else is searched for where somebody has asked for names.
    """
    return _and([title_of(d, other) for other in n["indistinguishable"]], "or")


def how_sure(d: Document) -> str:
    """How certain the names are, in one sentence."""
    effects = d["verdict"]["effects"]
    if not effects:
        before, expected = d.get("where", {}).get("before"), d["verdict"].get("adequacy", {}).get("bins_expected")
        if before is None or expected is None:
            return ""
        text = f"the model is biased in {len(before['flagged'])} of {len(before['bins'])} parts of the data (bins)"
        text += f", in its own simulations in {expected:.1f} on average"
        is_adequate = d["verdict"]["adequacy"]["outcome"] == "adequate"
        return f"{text}; this is within chance." if is_adequate else f"{text}."
    if d["verdict"].get("asked"):
        told = certainty(effects[0]) + "; nothing" if len(effects) == 1 else "Nothing"
        return f"{told} else was searched for, so nothing is known of what explains the data as well."
    if len(effects) == 1:
        others = not_told_apart(d, effects[0])
        return certainty(effects[0]) + (f"; cannot be told apart from {others}." if others else ".")
    certain = [title_of(d, form_of(n)) for n in effects if not n["indistinguishable"]]
    if len(certain) == len(effects):
        return "Each name can be told apart from everything else that was searched for."
    if certain:
        return f"Only {_and(certain)} can be told apart from everything else that was searched for."
    unlisted = all("something that is not listed" in n["indistinguishable"] for n in effects)
    end = ", nor from something that is not listed" if unlisted else ""
    return f"No name is certain: these data cannot tell any of them apart from other effects{end}."


def worse(d: Document) -> list[str]:
    """What gets worse with the additions: where the final model does worse in use, and for which drivers."""
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
    return found + worse_in_use(effects[-1])


def worse_in_use(n: Document) -> list[str]:
    """Where the model with an addition does worse than the base model beyond what both were fitted to."""
    return [str(line).replace("the last part", "the unseen last 40 %") for line in n.get("worse_where", ())]


def _number(driver: Document) -> str:
    """The number of a vehicle as the pictures have it, with its name in the recording where that differs."""
    number, name = str(driver["vehicle"]), str(driver.get("name", ""))
    return f"{number} ({name})" if name not in ("", number) else number


def _vehicles(names: list[str]) -> str:
    return f"vehicle{'s' if len(names) > 1 else ''} {_and(names)}"


def reasons(d: Document) -> list[str]:
    """What speaks against the final model."""
    said = d["verdict"].get("adequacy", {}).get("reasons", [])
    words = {"held-out samples": "unseen data", "the model without the additions": "the base model", ", by 0 m/s²": ""}
    lines = [plain(d, str(reason)) for reason in said]
    for old, new in words.items():
        lines = [line.replace(old, new) for line in lines]
    return lines


def what_to_do(d: Document) -> str:
    """What to do after the verdict."""
    effects, adequacy = d["verdict"]["effects"], d["verdict"].get("adequacy", {})
    advice = [text for n in effects for text in n.get("advice", ())]
    if advice:
        return f"To tell them apart, {'; '.join(advice)}."
    if adequacy.get("outcome") == "not_explained":
        names = "Do not take the names for causes. " if effects else ""
        return f"{names}Look below where the model{' still' if effects else ''} fails.{_best_predictor(d)}"
    if not effects:
        return (
            "Use the model as it is. The table of what these data would have shown says how small a missing effect may"
            " be."
        )
    if not any(map(is_supported, effects)):
        return "Leave it out, unless you know from elsewhere that the drivers have it."
    if not any(map(is_confirmed, effects)):
        return "Record more before you use it: unseen data do not confirm it."
    text = _use(d)
    if effects[-1].get("worse_where"):
        text += " If you simulate, diagnose with --for simulation: it adds nothing that makes free runs worse."
    return text


def _use(d: Document) -> str:
    """How to use the model with what was added."""
    if model := d.get("model_file"):
        return f"Use the model with it: give --model {model} to sugiyama run, live, simulate or compare."
    command = d.get("command") or "sugiyama diagnose FILE"
    then = "then give --model model.yaml to sugiyama run, live, simulate or compare."
    return f"Keep the model with it: {command} -o model.yaml; {then}"


def _best_predictor(d: Document) -> str:
    """Which model to use where prediction counts, if another law predicts better than the base or the final model."""
    better = d["verdict"].get("adequacy", {}).get("better_law")
    if not better:
        return ""
    law, final = (d["errors"].get(name, {}).get("loglik_per_sample") for name in (better, "after"))
    if d["verdict"]["effects"] and None not in (law, final) and final > law:
        return (
            f" Where only prediction counts, the model with the additions is the best one ({final:.3f} nats per sample;"
            f" {model_name(str(better))} {law:.3f})."
        )
    return f" {model_name(str(better))} predicts these data better; use it where only prediction counts."


def _and(names: list[str], word: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}" if names else ""
