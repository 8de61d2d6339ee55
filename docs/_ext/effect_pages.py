"""A page for each effect, with a picture of the same drivers without and with it."""

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from reference import GENERATED, declared, plain, table, write
from sphinx.application import Sphinx
from sphinx.config import Config

import sugiyama_ros as sg
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.effect import MEASUREMENT, Effect, Extent, Seen
from sugiyama_ros.effects.registry import MECHANISM, ROW
from sugiyama_ros.effects.shared import bump
from sugiyama_ros.simulation.experiment import Experiment, carry_out, changed

FOLDER = GENERATED / "effects"
#: Four cars start from rest on a ring [m]; the first two slow down on a stretch, the third has the effect. Where and
#: when effects of a place and a time act, and how long a picture lasts [s].
_SLOW = {"reduction": 0.8, "centre": 150.0, "width": 120.0}
_PLACE = {"centre": 360.0, "width": 100.0, "time": 45.0, "duration": 3.0}
_RING_M, _END_S = 650.0, 60.0
_WITHOUT, _WITH = "#7f7f7f", "#0072b2"


def shown_values(effect: Effect) -> dict[str, float]:
    """Values of an effect that a picture shows: the strongest of a benchmark and of the starts of a search."""
    first = effect.switches[0]
    known = [*effect.benchmark, *effect.starts(Extent(0.0, _END_S, _RING_M, 0.0, _RING_M))]
    values: Mapping[str, float] = max(
        known, key=lambda one: (1 - 2 * effect.is_limit) * abs(one.get(first, 0.0)), default={}
    )
    own = {p.name for p in effect.parameters}
    return {**values, **{name: value for name, value in _PLACE.items() if name in own}}


def drivers(effect: Effect, values: Mapping[str, float]) -> Array:
    """Rows of four drivers who hardly tremble, from the last to the first."""
    quiet = {} if effect.is_noise or effect.stage == MEASUREMENT else {"sigma_a": 0.03}
    base = ROW.with_effects(defaults(1))
    slow = changed(base, {"sigma_a": 0.03}, {"slow_patch": _SLOW})
    shown = changed(base, quiet, {effect.name: values} if values else {})
    return np.concatenate((changed(base, {"sigma_a": 0.03}, {}), shown, slow, slow))


def picture(effect: Effect, path: Path) -> bool:
    """Draw the third of four cars without and with an effect: the speed, or how far the measurement is off.

    Returns whether there is something to see.
    """
    measures = effect.stage == MEASUREMENT and effect.function is None
    seen = []
    for values in ({}, shown_values(effect)):
        run = carry_out(Experiment(ring_m=_RING_M, duration_s=_END_S, seed=1, gap_m=4.0), drivers(effect, values))
        seen.append(((run.dense.position_m - run.position_m) if measures else run.speed)[:, 1])
    without, with_effect = seen
    end = len(with_effect)
    difference = with_effect - without[:end]
    if not np.any(difference):
        return False
    time_s = np.arange(len(without)) * Experiment().period_s
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    style = "." if measures else "-"
    upper.plot(time_s, without, style, color=_WITHOUT, label="without")
    upper.plot(time_s[:end], with_effect, style, color=_WITH, label="with the effect")
    upper.set(ylabel="measured - true [m]" if measures else "speed [m/s]")
    upper.legend(loc="lower right")
    lower.plot(time_s[:end], difference, style, color=_WITH)
    lower.axhline(0.0, color=_WITHOUT, linewidth=0.8)
    lower.set(xlabel="time [s]", ylabel="difference")
    figure.savefig(path, dpi=100)
    return True


#: What stands below an equation with a bump.
BUMP = """`bump(x, width)` is a raised cosine: 1/2 + 1/2 cos(2π x / width) where |x| < width / 2, and 0 elsewhere. So
the effect is strongest in the middle of its part of the road, half as strong a quarter of the width away, and nothing
beyond half the width. It begins and ends smoothly, without a step that no driver could follow.

![A bump over the place, from half a width before its middle to half a width behind it](bump.png)
"""


def draw_bump(path: Path) -> None:
    """Draw a bump, as the effects compute it, over the distance from its middle as a share of its width."""
    place = np.linspace(-0.75, 0.75, 301)
    nothing = Seen(**dict.fromkeys(Seen._fields, 0.0))
    figure = Figure(figsize=(5.0, 1.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(place, [bump(nothing._replace(position=x), 0.0, 1.0) for x in place.tolist()], color=_WITH)
    axes.set_xticks([-0.5, -0.25, 0.0, 0.25, 0.5], ["-width/2", "-width/4", "centre", "width/4", "width/2"])
    axes.set(yticks=[0.0, 0.5, 1.0], ylabel="bump")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def section(effect: Effect, level: str) -> str:
    """What an effect does, its equation, parameters and picture."""
    values = shown_values(effect)
    shown = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    parts = [f"{level} {plain(effect.title or effect.name)}\n", f"`{effect.name}`: {plain(effect.summary)}.\n"]
    if effect.term:
        parts.append(f"```text\n{effect.term}\n```\n")
    if "bump(" in effect.term:
        parts.append(BUMP)
    parts.append(declared(effect.parameters))
    parts.append(f"Acts on: {effect.stage}. Source: {plain(effect.source)}.\n")
    if values and picture(effect, FOLDER / f"{effect.name}.png"):
        parts.append(f"![The third of four cars without and with the effect]({effect.name}.png)\n")
        parts.append(
            "The third of four cars that start from rest. The first two slow down between 90 and 210 m. Shown is"
            f" {plain(effect.name)} with {plain(shown)}; all random numbers are the same. A line that ends is a"
            " collision.\n"
        )
    return "\n".join(parts)


def page(mechanism: str, forms: list[Effect]) -> str:
    """The page of a mechanism with all its forms."""
    first = forms[0]
    values = ",".join(f"{name}={value:g}" for name, value in shown_values(first).items())
    parts = [section(first, "#"), *(section(form, "##") for form in forms[1:])]
    parts.append("## Try it\n")
    if values:
        parts.append(f"```sh\nsugiyama simulate --effect {first.name}:{values} -o hidden.mcap\n```\n")
    parts.append(f"```sh\nsugiyama diagnose FILE --add {mechanism}\n```\n")
    others = [(sg.effects[name].title or name, advice) for one in forms for name, advice in one.advice.items()]
    if others:
        parts += ["## Tell it from another effect\n", table(("from", "record"), others)]
    return "\n".join(parts)


def pages(app: Sphinx, config: Config) -> None:
    """Write the pages of all effects, and a list of them."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    draw_bump(FOLDER / "bump.png")
    rows = []
    for mechanism, forms in groupby(sg.effects.values(), lambda one: MECHANISM[one.name]):
        found = list(forms)
        write(f"effects/{mechanism}.md", page(mechanism, found))
        rows.append(
            (
                f"[{plain(found[0].title)}](effects/{mechanism}.md)",
                f"`{mechanism}`",
                plain(found[0].summary),
                found[0].stage,
            )
        )
    names = "\n".join(f"effects/{name}" for name in dict.fromkeys(MECHANISM.values()))
    write(
        "effects.md",
        "# Effects\n\nEvery effect is one file in `sugiyama_ros/effects`. {doc}`/howto/effect` says how to add"
        " one of your own.\n\n"
        + table(("effect", "name", "what it is", "acts on"), rows)
        + f"\n```{{toctree}}\n:hidden:\n\n{names}\n```\n",
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for files."""
    app.connect("config-inited", pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
