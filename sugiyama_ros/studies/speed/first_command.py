"""What is compiled: after an installation, for an effect of one's own, and after an edit.

The effect is that of `docs/howto/effect.md`, as another package offers it. "First" is the first command with it, in
which it is compiled, and "later" the same command again.
"""

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

#: Wanted ratios of first to later commands, after an installation and with an effect of one's own; and the wanted CPU
#: time [s] for what an edit of an effect makes necessary.
AT_MOST, OWN_AT_MOST, EDIT_AT_MOST_S = 1.2, 1.15, 5.0
_LATER = 4
_EFFECT = """
from numba import njit
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect, at

@njit
def push(seen, p):
    return -p[0] * seen.speed

EFFECT = Effect(
    name="syrup", stage=ENVIRONMENT, title="syrup on the road", summary="drag that grows with the speed",
    source="my notebook", parameters=(Parameter("k", "k", "1/s", 0.0, 0.0, 5.0, "drag per speed"),),
    starts=at({"k": 0.01}), function=push,
)
"""
_SIMULATE = (
    "simulate",
    "--vehicles",
    "8",
    "--ring",
    "84",
    "--duration",
    "150",
    "--seed",
    "1",
    "-o",
    "syrup.csv",
    "--overwrite",
)
_DIAGNOSE = ("diagnose", "syrup.csv", "--ring", "84")


def measure() -> tuple[SpeedFigure, ...]:
    """Compile a copy of the package as ``make demo`` does, then measure commands in it several times."""
    t = jam()
    with tempfile.TemporaryDirectory() as name, mock.patch.dict(os.environ):
        # Compiled code is kept beside the source, as after an installation.
        os.environ.pop("NUMBA_CACHE_DIR", None)
        folder = Path(name)
        source = Path(sugiyama_ros.__file__).parent
        shutil.copytree(source, folder / source.name, ignore=shutil.ignore_patterns("__pycache__"))
        write_csv(t, folder / "jam.csv")
        # Python looks for modules in the folder where it runs first.
        compiling = _compile(folder)
        first, later = _first_and_later(folder, *paper_command(t.road.circumference_m))
        of_edit = "compiling after an edit of one effect"
        return (
            SpeedFigure("compile_s", "compiling after an installation", compiling, "s of CPU time"),
            _ratio("first_command", "the first command after it over the same command later", first / later, AT_MOST),
            *_own_effect(folder),
            SpeedFigure("edit_s", of_edit, _edit(folder), "s of CPU time", EDIT_AT_MOST_S),
        )


def _own_effect(folder: Path) -> tuple[SpeedFigure, ...]:
    """Measure commands in this folder while an effect of another package comes and goes."""
    _first_and_later(folder, *_SIMULATE)
    about = folder / "mine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[sugiyama_ros.effects]\nsyrup = mine:EFFECT\n")
    (folder / "mine.py").write_text(_EFFECT)
    first, later = _first_and_later(folder, *_SIMULATE, "--effect", "syrup:k=0.05")
    first_diagnosis, later_diagnosis = _first_and_later(folder, *_DIAGNOSE)
    shutil.rmtree(about)
    without, later_without = _first_and_later(folder, *_SIMULATE)
    return (
        SpeedFigure("own_effect_s", "`simulate` with an effect of one's own, the first time", first, "s of CPU time"),
        _ratio("own_simulate", "the same over the same command later", first / later, OWN_AT_MOST),
        SpeedFigure("own_diagnose_s", "`diagnose` with it, 8 drivers", first_diagnosis, "s of CPU time"),
        _ratio("own_diagnose", "the same over the same command later", first_diagnosis / later_diagnosis, OWN_AT_MOST),
        _ratio("own_removed", "`simulate` after it was removed, over later", without / later_without, OWN_AT_MOST),
    )


def _edit(folder: Path) -> float:
    """Return what compiling takes after an edit of one effect, beyond what it takes when all is compiled [s]."""
    nothing = min(_compile(folder) for _ in range(2))
    file = folder / "sugiyama_ros/effects/drag.py"
    file.write_text(file.read_text().replace("return float(-p[0]", "return float(-1.5 * p[0]"))
    return max(_compile(folder) - nothing, 0.0)


def _ratio(name: str, text: str, value: float, at_most: float) -> SpeedFigure:
    return SpeedFigure(name, text, value, "times", at_most)


def _compile(folder: Path) -> float:
    """Compile all that is not compiled yet; CPU time [s]."""
    return cpu_of_command((sys.executable, "-m", "sugiyama_ros.compile"), folder)


def _first_and_later(folder: Path, *arguments: str) -> tuple[float, float]:
    """Run a command several times; CPU time [s] of the first time, and the least of the other times."""
    command = (sys.executable, "-m", "sugiyama_ros.cli", *arguments)
    first, *later = (cpu_of_command(command, folder) for _ in range(1 + _LATER))
    return first, min(later)
