"""The first command after an installation, compared with the same command later."""

import os
import shutil
import sys
import tempfile
from pathlib import Path
from unittest import mock

import sugiyama_ros
from sugiyama_ros.formats.plain_csv import write_csv
from sugiyama_ros.studies.speed.commands import paper_command
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_command
from sugiyama_ros.studies.speed.recording import jam

#: Wanted ratio of the first command to later ones.
AT_MOST = 1.2
_LATER = 4


def measure() -> tuple[SpeedFigure, ...]:
    """Compile a copy of the package as ``make demo`` does, then measure the paper's calibration several times."""
    t = jam()
    with tempfile.TemporaryDirectory() as name, mock.patch.dict(os.environ):
        # Compiled code is kept beside the source, as after an installation.
        os.environ.pop("NUMBA_CACHE_DIR", None)
        folder = Path(name)
        source = Path(sugiyama_ros.__file__).parent
        shutil.copytree(source, folder / source.name, ignore=shutil.ignore_patterns("__pycache__"))
        write_csv(t, folder / "jam.csv")
        # Python looks for modules in the folder where it runs first.
        compiling = cpu_of_command((sys.executable, "-m", "sugiyama_ros.compile"), folder)
        command = (sys.executable, "-m", "sugiyama_ros.cli", *paper_command(t.road.circumference_m))
        first, *later = (cpu_of_command(command, folder) for _ in range(1 + _LATER))
    return (
        SpeedFigure("compile_s", "compiling after an installation", compiling, "s of CPU time"),
        SpeedFigure(
            "first_command",
            "the first command after it over the same command later",
            first / min(later),
            "times",
            AT_MOST,
        ),
    )
