"""The figures as a table in text, as a JSON document, and as a page of the documentation."""

import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sugiyama_ros.results import plain
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.parts import PARTS

#: Figures of each part, by the name of the part.
Found = Mapping[str, tuple[SpeedFigure, ...]]
_HEAD = """# Speed

`make bench` measures all of this in one run. All times are CPU times. What is compared is measured in turn, several
times over, and the shortest time counts. So a ratio hardly depends on what else the machine does. The recording is
simulated: 22 drivers who start out of a jam, for 250 s. "at most" is the aim.

`.venv/bin/python -m sugiyama_ros.studies.speed --part NAME` measures one part, and `--json` prints a document. This
page is written by `.venv/bin/python -m sugiyama_ros.studies.speed --write docs/speed.md`.

Measured on {machine}.
"""


def machine() -> str:
    """Describe the machine and the libraries on which the speed depends."""
    info = Path("/proc/cpuinfo")
    models = [line.partition(": ")[2] for line in info.read_text().splitlines() if line.startswith("model name")]
    processor = models[0] if models else "an unknown processor"
    cores = len(os.sched_getaffinity(0))
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
    return f"{cores} cores of {processor}, Python {platform.python_version()}, {libraries}"


def document(found: Found) -> dict[str, Any]:
    """Collect everything for ``--json``."""
    figures = [{"part": part, **asdict(figure)} for part, figures in found.items() for figure in figures]
    return {"machine": machine(), "figures": plain(figures)}


def cells(figure: SpeedFigure) -> tuple[str, str, str]:
    """Write a figure in three cells: what it is, its value with its unit, and the aim."""
    aim = "" if figure.at_most is None else f"{figure.at_most:g}"
    return figure.text, f"{rounded(figure.value)} {figure.unit}", aim


def rounded(value: float) -> str:
    """Write a number with three digits that count, and large numbers without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def page(found: Found) -> str:
    """Write the page of the documentation, in Markdown."""
    parts = [_HEAD.format(machine=machine())]
    for part, figures in found.items():
        rows = "\n".join("| " + " | ".join(cells(figure)) + " |" for figure in figures)
        about = (import_module(PARTS[part]).__doc__ or "").strip()
        parts.append(f"## {part}\n\n{about}\n\n| what | measured | at most |\n|---|---|---|\n{rows}\n")
    return "\n".join(parts)
