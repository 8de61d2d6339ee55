"""Variations of the ring and of its drivers: all with the same seeds, compared in one table."""

from collections.abc import Callable, Mapping
from typing import Any

from sugiyama_ros.studies.rings import Ring, outcomes, run, space_time, summed_up
from sugiyama_ros.studies.study import Answer, Asked

#: What makes a ring from a seed, by the name of the case.
Cases = Mapping[str, Callable[[int], Ring]]


def compare(asked: Asked, cases: Cases) -> Answer:
    """Run all cases with the same seeds. The figure shows the first run of each case."""
    seeds = [asked.seed + k for k in range(asked.runs)]
    rings = [make(seed) for make in cases.values() for seed in seeds]
    found = outcomes(rings, asked.work)
    rows = tuple(
        {"case": name, **summed_up(found[k * len(seeds) : (k + 1) * len(seeds)])} for k, name in enumerate(cases)
    )

    def draw(figure: Any) -> None:
        columns = min(3, len(cases))
        lines = -(-len(cases) // columns)
        places = iter(figure.subplots(lines, columns, squeeze=False).flat)
        for (name, make), axes in zip(cases.items(), places, strict=False):
            space_time(axes, run(make(asked.seed)))
            axes.set(title=name)
        for axes in list(places):
            axes.set_visible(False)

    return Answer(rows, draw)
