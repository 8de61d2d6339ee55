"""What commands take besides their work: the start of the program, and the loading of compiled code.

Most of what the paper's calibration takes as a command is numba: its import, its tables of all functions that can be
compiled, the linear algebra of scipy, and the loading of the compiled code. Together they take more than ten times the
mathematics. So this command does not reach its aim, and cannot reach it with numba.
"""

import sys
import tempfile
from pathlib import Path

from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.formats.plain_csv import write_csv
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_commands, cpu_of_functions
from sugiyama_ros.studies.speed.recording import jam

#: Wanted ratios: ``--help`` to ``import numpy``, and the paper's calibration as a command to its own mathematics.
HELP_AT_MOST, PAPER_AT_MOST = 3.0, 10.0
_ROUNDS = 7


def measure() -> tuple[SpeedFigure, ...]:
    """Measure commands with compiled code at hand, in turn with ``import numpy`` and ``import numba``."""
    t = jam()
    mathematics = cpu_of_functions({"paper": lambda: each_driver(t, Settings("paper"))}, rounds=5)["paper"]
    sugiyama = (sys.executable, "-m", "sugiyama_ros.cli")
    commands = {
        "numpy": (sys.executable, "-c", "import numpy"),
        "numba": (sys.executable, "-c", "import numba"),
        "help": (*sugiyama, "--help"),
        "paper": (*sugiyama, *paper_command(t.road.circumference_m)),
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
            PAPER_AT_MOST,
        ),
    )


def paper_command(ring_m: float) -> tuple[str, ...]:
    """Make the arguments of the paper's calibration of ``jam.csv``.

    ring_m: circumference of the ring [m].
    """
    return ("calibrate", "jam.csv", "--ring", str(ring_m), "--formulation", "paper")
