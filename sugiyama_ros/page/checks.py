"""Words for the checks of a final model: what each compares, and which ones fail."""

import re

from sugiyama_ros.page.names import Document, chance, model_name, named, quantity, spaced, titled

# What checks compare, by name; further names are a prefix and what it is about.
_CHECKS = {
    "spread_of_innovations": "spread of one-step errors",
    "correlation_of_innovations": "correlation of one-step errors",
    "mean_speed": "mean speed",
    "least_speed": "smallest speed",
    "largest_speed": "largest speed",
    "wave_speed": "speed of the waves",
    "queue_vehicles": "vehicles in a queue",
    "period_s": "time between two waves",
}
_RUNS = {"single": "one car", "road": "all cars"}


def failed(d: Document) -> list[Document]:
    """The checks that fail, the smallest p-value first; but traffic that stands still before everything else."""
    fails = (one for one in d["checks"] if one["failed"])
    return sorted(fails, key=lambda one: (not _is_standstill(one), float(one["p_value"])))


def _is_standstill(check: Document) -> bool:
    """Whether a check says that the traffic of the model stands, while the measured traffic moves."""
    # imported here: the live page takes words from this room, and needs no diagnosis
    from sugiyama_ros.diagnosis.where import STANDING

    return check["name"] == "mean_speed" and float(check["expected"]) < STANDING <= float(check["value"])


def standstill(d: Document) -> str:
    """Says that the final model's own traffic stands still; empty if it does not."""
    worst = failed(d)[:1]
    if not worst or not _is_standstill(worst[0]):
        return ""
    measured, given, _ = check_values(worst[0])
    return f"in the model's own simulations the traffic stands still (mean speed {given}, measured {measured}). "


def checks_hold(d: Document) -> str:
    """How many checks hold."""
    every = len(d["checks"])
    return f"{every - len(failed(d))} of {every} checks hold"


def check_title(d: Document, check: Document) -> str:
    """What a check compares."""
    name = str(check["name"])
    if name in _CHECKS:
        return _CHECKS[name]
    if found := re.fullmatch(r"bias_over_(\w+)", name):
        return f"bias over the {spaced(found[1])}"
    if found := re.fullmatch(r"spread_of_(single|road)_runs_([\d.]+)s", name):
        return f"spread of {_RUNS[found[1]]} after {found[2]} s"
    if found := re.fullmatch(r"left_for_(\w+)", name):
        return f"left for {titled(d, found[1])}"
    if found := re.fullmatch(r"gain_of_(\w+)", name):
        return f"lead of {_other(d, found[1])}"
    if found := re.fullmatch(r"sign_of_(\w+)\.(\w+)", name):
        return f"{found[2]} of {named(d, found[1])}"
    return spaced(name)


def _other(d: Document, name: str) -> str:
    """Name of another law, or of another form of what was added."""
    form = name.removesuffix("_of_some")
    if d.get("about", {}).get(form, {}).get("kind") != "effect":
        return model_name(name)
    return f"{named(d, form)} of some drivers" if form != name else named(d, form)


def check_values(check: Document) -> tuple[str, str, str]:
    """What was measured, what the model gives, and the p-value of a check."""
    unit = str(check["unit"]) if check["unit"] != "1" else ""
    numbers = (quantity(float(check[name]), unit) for name in ("value", "expected"))
    return (*numbers, chance(check["p_value"]))  # type: ignore[return-value]


def check_in_words(d: Document, check: Document) -> str:
    """A check with its values: what was measured, and what the model's own simulations give."""
    measured, given, p = check_values(check)
    name, title = str(check["name"]), check_title(d, check)
    if name.startswith("left_for_"):
        where = "the fitted data" if d["verdict"].get("asked") else "unseen data"
        return f"{named(d, name.removeprefix('left_for_'))} would still gain {measured} on {where} ({p})"
    if name.startswith("gain_of_"):
        return f"{_other(d, name.removeprefix('gain_of_'))} gains {measured} more on unseen data ({p})"
    if name.startswith("sign_of_"):
        return f"{title} is {measured}; below {given} it makes no physical sense"
    kind = name.partition("_")[0]
    units = {"bias": " predicted standard deviations", "spread": " times what is predicted"}.get(kind, "")
    return f"{title}: {measured}{units}, in the model's own simulations {given} ({p})"


def reasons(d: Document) -> list[str]:
    """What speaks against the final model: its failed checks."""
    return [check_in_words(d, one) for one in failed(d)]
