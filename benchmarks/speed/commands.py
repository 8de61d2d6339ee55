"""What is measured of whole commands: their start, what is compiled, and their time and memory on many drivers."""

import os
import shutil
import sys
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np

import sugiyama_ros
from benchmarks.speed.timing import SpeedFigure, cpu_of_command, cpu_of_commands, cpu_of_functions, jam, used_by_command
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import SIGMA_A, defaults
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.table import write_csv
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.simulation.lanes import Lane, simulate_lanes
from sugiyama_ros.studies.rings import LENGTH_M
from sugiyama_ros.trajectories.tracks import Tracks

#: Wanted ratios: ``--help`` to ``import numpy``, and the paper's calibration as a command to its own mathematics.
HELP_AT_MOST, _PAPER_AT_MOST = 3.0, 10.0
_ROUNDS = 7
#: Wanted ratios of first to later commands, after an installation and with an effect of one's own; and the wanted CPU
#: time [s] for what an edit of an effect makes necessary.
_FIRST_AT_MOST, _OWN_AT_MOST, _EDIT_AT_MOST_S = 1.2, 1.15, 5.0
_LATER = 4
_OVER_LATER = "over the same command later"
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
_RING = ("--ring", "84")
_SIMULATE = (
    "simulate",
    *_RING,
    "--vehicles",
    "8",
    "--duration",
    "150",
    "--seed",
    "1",
    "-o",
    "syrup.csv",
    "--overwrite",
)
_DIAGNOSE = ("diagnose", *_RING, "syrup.csv")
# Lanes, vehicles on each, the time [s] for which they drive, and acceleration noise [m/s^2] with which nobody collides.
_LANES, _VEHICLES, _DURATION_S, _CALM = 96, 22, 60.0, 0.1
# The drivers of NGSIM who are taken, and the file of pairs in which they are.
_DRIVERS = 94
_NGSIM = Path(__file__).parents[3] / "shared/data/ngsim_i80_pairs/ngsim_i80_pairs.parquet"
_SUGIYAMA = (sys.executable, "-m", "sugiyama_ros.cli")


def commands() -> tuple[SpeedFigure, ...]:
    """What commands take besides their work: the start of the program, and the loading of compiled code.

    Most of what the paper's calibration takes as a command is numba: its import, its tables of all functions that can
    be compiled, the linear algebra of scipy, and the loading of the compiled code. Together they take more than ten
    times the mathematics. So this command does not reach its aim, and cannot reach it with numba.
    """
    t = jam()
    mathematics = cpu_of_functions({"paper": lambda: each_driver(t, Settings("paper"))}, rounds=5)["paper"]
    commands = {
        "numpy": (sys.executable, "-c", "import numpy"),
        "numba": (sys.executable, "-c", "import numba"),
        "help": (*_SUGIYAMA, "--help"),
        "paper": (*_SUGIYAMA, *_paper_command(t.road.circumference_m)),
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_csv(t, folder / "jam.csv")
        spent = cpu_of_commands(commands, _ROUNDS, folder)
    return (
        SpeedFigure(
            "help_over_numpy",
            "`sugiyama --help` over `import numpy`",
            spent["help"] / spent["numpy"],
            "times",
            HELP_AT_MOST,
        ),
        SpeedFigure("import_numba_s", "`import numba` alone", spent["numba"], "s of CPU time"),
        SpeedFigure("paper_command_s", "`sugiyama calibrate --formulation paper`", spent["paper"], "s of CPU time"),
        SpeedFigure(
            "paper_command_over_mathematics",
            "the same over its own mathematics",
            spent["paper"] / mathematics,
            "times",
            _PAPER_AT_MOST,
        ),
    )


def _paper_command(ring_m: float) -> tuple[str, ...]:
    """Arguments of the paper's calibration of ``jam.csv`` on a ring [m]."""
    return ("calibrate", "jam.csv", "--ring", str(ring_m), "--formulation", "paper")


def first() -> tuple[SpeedFigure, ...]:
    """What is compiled: after an installation, for an effect of one's own, and after an edit.

    The effect is that of `docs/howto/effect.md`, as another package offers it. "First" is the first command with it, in
    which it is compiled, and "later" the same command again.
    """
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
        first, later = _first_and_later(folder, *_paper_command(t.road.circumference_m))
        of_edit = "compiling after an edit of one effect"
        return (
            SpeedFigure("compile_s", "compiling after an installation", compiling, "s of CPU time"),
            _ratio(
                "first_command", "the first command after it over the same command later", first / later, _FIRST_AT_MOST
            ),
            *_own_effect(folder),
            SpeedFigure("edit_s", of_edit, _edit(folder), "s of CPU time", _EDIT_AT_MOST_S),
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
        _ratio("own_simulate", f"the same {_OVER_LATER}", first / later, _OWN_AT_MOST),
        SpeedFigure("own_diagnose_s", "`diagnose` with it, 8 drivers", first_diagnosis, "s of CPU time"),
        _ratio("own_diagnose", f"the same {_OVER_LATER}", first_diagnosis / later_diagnosis, _OWN_AT_MOST),
        _ratio("own_removed", "`simulate` after it was removed, over later", without / later_without, _OWN_AT_MOST),
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
    command = (*_SUGIYAMA, *arguments)
    first, *later = (cpu_of_command(command, folder) for _ in range(1 + _LATER))
    return first, min(later)


def many_on_lanes() -> tuple[SpeedFigure, ...]:
    """The calibration of two thousand simulated drivers on lanes, as a command."""
    rows = defaults(_VEHICLES)
    rows[:, SIGMA_A] = _CALM
    lane = Lane(rows, np.full(_VEHICLES, LENGTH_M), ["car"] * _VEHICLES)
    tracks = simulate_lanes([lane] * _LANES, _DURATION_S, np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_tracks(tracks, folder / "drivers.parquet")
        used = used_by_command((*_SUGIYAMA, "calibrate", "drivers.parquet"), folder)
    text = f"calibration of {_LANES * (_VEHICLES - 1):,} drivers of {_DURATION_S:.0f} s, {len(tracks):,} rows"
    return (
        SpeedFigure("many_on_lanes_s", text, used.cpu_s, "s of CPU time"),
        SpeedFigure("many_on_lanes_mb", "memory of all its processes", used.memory_mb, "MB", 1000),
    )


def ngsim() -> tuple[SpeedFigure, ...]:
    """Commands on 94 measured drivers of NGSIM I-80 and on those ahead of them. Without their file it is left out."""
    if not _NGSIM.exists():
        raise InputError(f"{_NGSIM}: not found; put the car-following pairs of NGSIM I-80 there")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_tracks(_first_drivers(read_tracks(_NGSIM)), folder / "drivers.parquet")
        calibrate, diagnose, run = (
            used_by_command((*_SUGIYAMA, command, "drivers.parquet", "--json", *more), folder)
            for command, *more in (("calibrate",), ("diagnose",), ("run", "-o", "run.mcap"))
        )
        size_mb = (folder / "run.mcap").stat().st_size / 1e6
    return (
        SpeedFigure("ngsim_calibrate_s", "calibration of a driver", calibrate.cpu_s / _DRIVERS, "s of CPU time", 0.8),
        SpeedFigure("ngsim_calibrate_mb", "memory of this calibration", calibrate.memory_mb, "MB"),
        SpeedFigure("ngsim_diagnose_s", f"diagnosis of {_DRIVERS} drivers", diagnose.cpu_s, "s of CPU time", 150),
        SpeedFigure("ngsim_diagnose_mb", "memory of this diagnosis", diagnose.memory_mb, "MB", 700),
        SpeedFigure("ngsim_run_s", "run of these drivers", run.cpu_s, "s of CPU time", 25),
        SpeedFigure("ngsim_run_mb", "memory of this run", run.memory_mb, "MB"),
        SpeedFigure("ngsim_run_bag_mb", "size of the recording", size_mb, "MB", 10),
    )


def _first_drivers(tracks: Tracks) -> Tracks:
    """The first drivers who follow somebody, and those ahead of them."""
    follows = tracks.leader_row >= 0
    first = np.unique(tracks.run[follows])[:_DRIVERS]
    ahead = tracks.run[tracks.leader_row[follows & np.isin(tracks.run, first)]]
    return tracks.select(np.isin(tracks.run, np.concatenate((first, ahead))))
