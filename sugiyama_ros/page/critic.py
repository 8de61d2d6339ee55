"""What the critic of a run says, beside the verdict of a diagnosis; and why the two may differ."""

import math
from collections.abc import Collection, Mapping
from functools import partial

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.page.names import Document, title_of

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


def preferred(weights: Mapping[str, Array]) -> tuple[str, float]:
    """Return the model that a critic prefers at the end, and by how many nats it leads the base model.

    weights: probability of each model, among them ``base``, at each verdict of the critic.
    """
    last = {name: float(np.nan_to_num(series[-1])) for name, series in weights.items()}
    best = max(last, key=lambda name: last[name])
    base = last.get("base", 0.0)
    return best, math.log(last[best] / base) if base > 0.0 else math.inf


def beside_the_verdict(d: Document | None, best: str, added: Collection[str], lead: float = math.inf) -> str:
    """Say what a critic prefers at the end, and whether the verdict of a diagnosis says the same.

    best: the model that the critic prefers; ``base`` is the model that the estimators had.
    """
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
