"""Another package adds a file format through an entry point, and every command reads it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.formats.plain_csv import write_csv
from sugiyama_ros.formats.registry import BUILT_IN, formats, known_suffixes, read_trajectories
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

pytestmark = pytest.mark.system
RING_M = 50.0

MINE = """
from sugiyama_ros.formats import Format
from sugiyama_ros.formats.plain_csv import read_csv


def read(path, ring_m):
    '''A table as in the plain CSV, under a first line that says what it is and how long the ring is.'''
    first, _, table = path.read_text().partition("\\n")
    below = path.with_name("below.csv")
    below.write_text(table)
    return read_csv(below, float(first.split()[1]))


FORMAT = Format("mine", (".mine",), lambda head, path: head.startswith(b"%MINE "), read, "a table under a line")
"""


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """A folder with a package that adds a format, and a package whose format cannot be loaded."""
    folder = tmp_path / "packages"
    about = folder / "mine-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "mine.py").write_text(MINE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[sugiyama_ros.formats]\nmine = mine:FORMAT\nworn = mine:MISSING\n")
    return folder


def sugiyama(packages: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the program in a process that finds the packages."""
    places = [str(packages), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-c", "from sugiyama_ros.cli import main; main()", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))},
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_format_of_another_package_is_read_by_the_commands(tmp_path: Path, packages: Path) -> None:
    length = np.full(4, 4.33)
    simulator = Simulator(defaults(4), length, platoon(length, 4.0), Road(RING_M), np.random.default_rng(1))
    table, file, bag = tmp_path / "a.csv", tmp_path / "a.mine", tmp_path / "a.mcap"
    write_csv(simulate(simulator, 60.0).measured, table)
    file.write_text(f"%MINE {RING_M}\n{table.read_text()}")

    converted = sugiyama(packages, "convert", file, bag, "--json")
    assert converted.returncode == 0, converted.stderr
    assert json.loads(converted.stdout)["ring_m"] == RING_M
    np.testing.assert_allclose(
        read_trajectories(bag).position_m, read_trajectories(table, RING_M).position_m, rtol=0.0, atol=1e-9
    )

    drivers = []
    for source in ([file], [table, "--ring", RING_M]):
        done = sugiyama(packages, "calibrate", *source, "--formulation", "paper", "--json")
        assert done.returncode == 0, done.stderr
        drivers.append(json.loads(done.stdout)["drivers"])
    assert drivers[0] == drivers[1]


def test_messages_name_the_formats_of_other_packages(tmp_path: Path, packages: Path) -> None:
    (tmp_path / "a.txt").write_text("what is this")
    refused = sugiyama(packages, "convert", tmp_path / "a.txt", tmp_path / "a.mcap")
    assert refused.returncode != 0
    text = " ".join(refused.stderr.split())
    assert "give a file in .mine, .mcap, .data, .csv" in text
    assert "format worn: mine:MISSING cannot be loaded: AttributeError" in text


def test_every_built_in_format_explains_itself() -> None:
    for known in formats()[-len(BUILT_IN) :]:
        assert known.summary
        assert all(suffix in known_suffixes() for suffix in known.suffixes)
