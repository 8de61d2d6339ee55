"""Studies of few drivers and few runs: an answer, or one line with the cure; never a warning."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.studies import rings
from sugiyama_ros.studies.rings import jams

pytestmark = pytest.mark.system
SUGIYAMA = str(Path(sys.executable).with_name("sugiyama"))


def told(here: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([SUGIYAMA, *arguments], cwd=here, capture_output=True, text=True, timeout=200)


@pytest.fixture
def here(tmp_path: Path) -> Path:
    for name, vehicles, ring in (("six.csv", "6", "70"), ("two.csv", "2", "40")):
        made = told(tmp_path, "simulate", "--vehicles", vehicles, "--ring", ring, "--duration", "40", "-o", name)
        assert made.returncode == 0, made.stderr
    return tmp_path


def test_types_of_few_drivers(here: Path) -> None:
    """There are fewer clusters than drivers, and two drivers have no types."""
    done = told(here, "study", "types", "six.csv", "--ring", "70", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [row["clusters"] for row in rows] == list(range(2, rows[0]["drivers"]))
    assert all(np.isfinite(row["agreement of draws"]) for row in rows)
    done = told(here, "study", "types", "two.csv", "--ring", "40")
    assert done.returncode == 2
    assert done.stderr.startswith("error: study types: v_star is identified for ")
    assert len(done.stderr.splitlines()) == 1


def test_measured_drivers_of_whom_one_is_identified(here: Path) -> None:
    done = told(here, "study", "measured", "two.csv", "--ring", "40", "--json")
    assert (done.returncode, done.stderr) == (0, "")


def test_where_all_runs_collide_the_cure_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    class Crash:
        collisions = (1,)

    monkeypatch.setattr(rings, "run", lambda ring: Crash())
    with pytest.raises(InputError, match=r"cars collide in all simulated runs \(2\); give more --runs, or another"):
        list(jams({}, 2, 0, 10.0))
