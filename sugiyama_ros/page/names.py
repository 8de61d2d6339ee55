"""Names and numbers for people: of what a document of a diagnosis or of a comparison mentions."""

import math
import re
from collections.abc import Mapping
from typing import Any

from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.results import CLEARLY, figure

Document = Mapping[str, Any]
#: Errors [m] below this are told in millimetres.
SMALL_M = 0.01
# Lengths [m] and speeds [m/s] below this are told in millimetres.
_SMALL = 1e-3
#: A difference is clear from this number of standard errors on.
CLEAR = CLEARLY
# Effects that the name of a model in a table has, of more it says the number.
_FEW = 3
# A loss [nats] that rounds to nothing is not told.
_LEAST = -0.5
# Symbols in the meanings of parameters.
_SYMBOLS = {"v*": "the desired speed", "κ_v": "the risk premium", "sigma_a": "the acceleration noise"}
#: Effect that stands for a force along a covariate.
FORCE = "discovered_force"
#: Names of the base model and of the final one, and of the final one on recordings that it simulates.
MODELS = ("before", "after", "floor")
#: Units of covariates.
UNITS = {
    "speed": "m/s",
    "approach_rate": "m/s",
    "gap": "m",
    "rear_gap": "m",
    "second_gap": "m",
    "place": "m",
    "time": "s",
    "time_gap": "s",
}


def form_of(n: Document) -> str:
    """Name that declares the parameters of an addition: forms of a mechanism have parameters of their own."""
    return FORCE if n.get("covariate") else str(n.get("form") or n["name"])


def title_of(d: Document, name: str) -> str:
    """Name for people of an effect, a group of constants or a law, or of the base model of a critic."""
    explained = d.get("about", {}).get(name)
    return str(explained["title"]) if explained else "the base model" if name == "base" else name.replace("_", " ")


def summary_of(d: Document, name: str) -> str:
    """Explanation of a name in one line; empty where the document has none."""
    return str(d.get("about", {}).get(name, {}).get("summary", ""))


def titled(d: Document, name: str) -> str:
    """Name for people of anything that can be added: an effect, a form, constants, or a force along a covariate."""
    effect, _, covariate = _typed(name).partition(":")
    return f"{title_of(d, effect)} along the {spaced(covariate)}" if covariate else title_of(d, effect)


def named(d: Document, name: str) -> str:
    """Name for people, with the identifier that is typed: slower stretch of road (slow_patch)."""
    title, typed = titled(d, name), _typed(name)
    return title if title == typed else f"{title} ({typed})"


def _typed(name: str) -> str:
    """What is typed for a candidate."""
    name = name.removesuffix("_of_some")
    along = "force_along_"
    return f"{FORCE}:{name.removeprefix(along)}" if name.startswith(along) else name


def addition(d: Document, n: Document) -> str:
    """Name of an addition for people, with its identifier."""
    return named(d, f"{FORCE}:{n['covariate']}" if n.get("covariate") else form_of(n))


def short_name(name: str) -> str:
    """Name of a model for the first column of a table: a few identifiers of what it has beyond the base model."""
    with_effects = re.fullmatch(r"(base \+|file:) (.+)", name)
    if not with_effects:
        return model_name(name)
    effects = re.split(r", | \+ ", with_effects[2])
    more = f" and {len(effects) - _FEW} more" if len(effects) > _FEW else ""
    return f"{with_effects[1].removeprefix('base ')} {', '.join(effects[:_FEW])}{more}"


def model_name(name: str) -> str:
    """Name of a model in sentences and legends."""
    known = dict(zip(MODELS, ("base model", "with what was added", "floor (simulated)"), strict=True))
    if name in known:
        return known[name]
    if name.startswith(("base", "file:")):
        return re.sub(r"\w+", lambda found: _effect_name(found[0]), name)
    law = name.removesuffix("_least_squares")
    return (LAWS[law].title if law in LAWS else spaced(law)) + (", fitted to gaps" if law != name else "")


def _effect_name(name: str) -> str:
    """Name for people of an effect, with its identifier; another name as it is."""
    title = EFFECTS[name].title if name in EFFECTS else name
    return title if title == name else f"{title} ({name})"


def column_name(column: str) -> str:
    """Name of a column of gains."""
    if column in ("one_step", "all"):
        return {"one_step": "one step ahead", "all": "over all horizons"}[column]
    cars, seconds = ("all cars", column.removeprefix("road_")) if column.startswith("road_") else ("one car", column)
    return f"{cars} at {seconds.removesuffix('s')} s"


def models(d: Document) -> dict[str, Document]:
    """Errors of the models by name, without a model that equals the base model because nothing was added."""
    return {name: one for name, one in d["errors"].items() if name != "after" or d["verdict"]["effects"]}


def meaning_of(parameter: Document, name: str) -> str:
    """Meaning of a parameter in a few words; what follows a semicolon is where the declaration comes from."""
    words = str(parameter.get("meaning", spaced(name))).split(";")[0]
    words = re.sub(r"\blog (\S+)", r"the logarithm of \1", words)
    return re.sub("|".join(map(re.escape, _SYMBOLS)), lambda found: _SYMBOLS[found[0]], words)


def parameter_title(name: str, *, with_unit: bool = False) -> str:
    """Name of a driver's parameter for people, with its symbol: desired speed v*; with its unit for an axis."""
    if name not in ROW.entries:
        return spaced(name)
    declared = ROW.declared[ROW.entries.index(name)]
    words = f"{re.split('[;,]', declared.description)[0]} {declared.symbol}"
    return f"{words} [{unit_of(name)}]" if with_unit and unit_of(name) else words


def unit_of(name: str) -> str:
    """Unit of a driver's parameter for people; empty for a number."""
    unit = ROW.declared[ROW.entries.index(name)].unit if name in ROW.entries else "1"
    return "" if unit == "1" else _superscript(unit)


def _superscript(unit: str) -> str:
    return unit.replace("^2", "²").replace("^3", "³")


def quantity(value: float, unit: str = "", std: float | None = None, digits: int = 3) -> str:
    """A value with its standard deviation and its unit; without a standard deviation, with so many digits."""
    if std is None or not (math.isfinite(std) and std > 0.0):
        if 0.0 < abs(value) < _SMALL and unit in ("m", "m/s"):
            value, unit = 1e3 * value, f"m{unit}"
        text = figure(value, digits)
    else:
        places = min(max(-math.floor(math.log10(std)), 0), 5)
        text = f"{value:.{places}f} ± {std:.{places}f}"
    return f"{text} {_superscript(unit)}".strip()


def nats(value: float, se: float) -> str:
    """A gain with its standard error, without the unit."""
    return f"{round(value)} ± {round(se)}"


def length(value_m: float) -> str:
    """A length [m] with three digits, so that lengths beside each other end alike."""
    return f"{value_m:#.3g}".rstrip(".") if value_m < 1e3 else f"{value_m:.0f}"


def distances(*values_m: float) -> list[str]:
    """Lengths [m] with their unit: millimetres where all are small, as where somebody has smoothed the positions."""
    if any(abs(value) >= SMALL_M for value in values_m):
        return [f"{length(value)} m" for value in values_m]
    return [f"{length(1e3 * value)} mm" for value in values_m]


def chance(p_value: float | None) -> str:
    """A p-value for people."""
    if p_value is None:
        return ""
    return "p < 0.001" if p_value < 1e-3 else f"p {p_value:.2g}"


def gained(one: Mapping[str, float]) -> str:
    """A gain of a column with its standard error, without the unit."""
    return nats(one["nats"], one["se"])


def worse_columns(gains: Mapping[str, Mapping[str, float]], *, clearly: bool = True) -> list[str]:
    """Columns in which a model is worse than another by two standard errors; or those in which it is less worse."""
    found = {name: one for name, one in gains.items() if one["nats"] < -CLEAR * one["se"]}
    if not clearly:
        found = {name: one for name, one in gains.items() if name not in found and one["nats"] <= _LEAST}
    return [f"{column_name(name)} {gained(one)} nats" for name, one in found.items()]


def spaced(name: object) -> str:
    """A name with blanks."""
    return str(name).replace("_", " ")


def listed(names: list[str], word: str = "and") -> str:
    """Names as a sentence lists them."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}" if names else ""


def not_found(n: Document) -> str:
    """Says that the fitted strength of what somebody asked for is zero; empty if it is not."""
    return "" if any(n["gains"]["all"].values()) else "nothing was found: the fitted strength is 0"
