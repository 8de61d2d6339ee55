"""``python -m benchmarks.speed``: all parts, as a table in text, as a JSON document, and as a page of results."""

import argparse
import inspect
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks import speed
from benchmarks.speed.timing import SpeedFigure
from sugiyama_ros.errors import InputError
from sugiyama_ros.results import plain

#: Figures of each part, by the name of the part.
Found = Mapping[str, tuple[SpeedFigure, ...]]
#: The module of each part, in which a function has the name of the part, in the order in which they run.
PARTS = {
    "floors": "benchmarks.speed.parts",
    "peers": "benchmarks.speed.peers",
    "calibration": "benchmarks.speed.parts",
    "diagnosis": "benchmarks.speed.parts",
    "commands": "benchmarks.speed.commands",
    "first": "benchmarks.speed.commands",
    "throughput": "benchmarks.speed.parts",
    "run": "benchmarks.speed.run",
    "tracks": "benchmarks.speed.parts",
    "many": "benchmarks.speed.parts",
    "many_on_lanes": "benchmarks.speed.commands",
    "ngsim": "benchmarks.speed.commands",
}


def main() -> None:
    """Measure, and print the figures of each part as soon as they are known."""
    parser = argparse.ArgumentParser(description=speed.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="measure this part; all parts by default")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the figures as a page in Markdown")
    given = parser.parse_args()
    found: dict[str, tuple[SpeedFigure, ...]] = {}
    for part in given.part or PARTS:
        try:
            found[part] = _of(part)()
        except InputError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        if not given.json:
            _print_figures(part, found[part])
    if given.json:
        figures = [{"part": part, **asdict(figure)} for part, figures in found.items() for figure in figures]
        print(json.dumps({"machine": _machine(), "figures": plain(figures)}, indent=2))
    if given.write is not None:
        given.write.write_text(_page(found))


def _of(part: str) -> Callable[[], tuple[SpeedFigure, ...]]:
    """The function that measures a part. Raises InputError if a library is missing."""
    try:
        measure: Callable[[], tuple[SpeedFigure, ...]] = getattr(import_module(PARTS[part]), part)
    except ModuleNotFoundError as error:
        raise InputError(f"{part}: {error.name} is not installed; see requirements-dev.txt") from None
    return measure


def _print_figures(part: str, figures: tuple[SpeedFigure, ...]) -> None:
    print(part)
    for text, value, aim in map(_cells, figures):
        print(f"    {text:<88}{value:>24}" + (f"   at most {aim}" if aim else ""), flush=True)


def _machine() -> str:
    """The machine and the libraries on which the speed depends."""
    info = Path("/proc/cpuinfo")
    models = [line.partition(": ")[2] for line in info.read_text().splitlines() if line.startswith("model name")]
    processor = models[0] if models else "an unknown processor"
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
    cores = len(os.sched_getaffinity(0))
    return f"{cores} cores of {processor}, Python {platform.python_version()}, {libraries}"


def _cells(figure: SpeedFigure) -> tuple[str, str, str]:
    """What a figure is, its value with its unit, and the aim."""
    # three digits that count, and large numbers without an exponent
    value = f"{figure.value:,.0f}" if abs(figure.value) >= 100.0 else f"{figure.value:.3g}"
    return figure.text, f"{value} {figure.unit}", "" if figure.at_most is None else f"{figure.at_most:g}"


def _page(found: Found) -> str:
    """The page of results, in Markdown."""
    about, _, how = (speed.__doc__ or "").partition("\n\n")
    parts = [f"# Speed\n\n{about}\n\n{how.strip()}\n\nMeasured on {_machine()}.\n"]
    for part, figures in found.items():
        rows: list[Any] = ["| " + " | ".join(_cells(figure)) + " |" for figure in figures]
        head = f"## {part}\n\n{inspect.getdoc(_of(part))}\n\n| what | measured | at most |\n|---|---|---|\n"
        parts.append(head + "\n".join(rows) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    main()
