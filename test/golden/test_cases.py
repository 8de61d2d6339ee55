"""Recordings of people who tried the package, with the right answers. Skipped without them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import sugiyama_ros as sg
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.diagnosis.table import errors
from sugiyama_ros.page.document import additions
from sugiyama_ros.verdict.compare import Comparison

CASES = Path(__file__).parents[2].parent / "shared/cases"
pytestmark = pytest.mark.skipif(not CASES.exists(), reason="needs recordings that are not in the repository")
#: What `pip install` would write for the package of the case with an effect of its own.
ABOUT = {
    "METADATA": "Metadata-Version: 2.1\nName: dead_zone_pkg\nVersion: 1.0\n",
    "entry_points.txt": "[sugiyama_ros.effects]\ndead_zone = dead_zone_pkg.zone:EFFECT\n",
}
DIAGNOSE = """
import json, sys
import sugiyama_ros as sg
from sugiyama_ros.page.document import additions
found = additions(sg.diagnose(sg.read(sys.argv[1], ring_m=100.0), add=["dead_zone"]))
print(json.dumps([[one.name, one.is_supported, one.p_value, one.parameters["width"]] for one in found]))
"""


def of_file(compared: Comparison) -> tuple[dict, dict]:
    """The base model and the model of a file, in numbers."""
    (given,) = (one for one, model in zip(compared.records(), compared.models, strict=True) if model.kind == "given")
    return compared.records()[0], given


def test_a_hill_that_was_found_holds_for_other_people(tmp_path: Path) -> None:
    recordings = (sg.read(CASES / f"model_of_other_people/{name}.csv", ring_m=130.0) for name in "ce")
    found, other = sg.diagnose(next(recordings), add=["road_grade"], simulations=1), next(recordings)
    found.save(tmp_path / "c.yaml")
    compared = sg.compare(other, model=tmp_path / "c.yaml")
    base, given = of_file(compared)
    assert given["heldout_gain_nats"] > 4.0 * given["heldout_gain_se"]
    # 1.45 -> 1.03 m with the hill fitted to the other people
    assert given["free_run_10s_m"] < 0.8 * base["free_run_10s_m"]
    assert "forecasts unseen data best" in compared.headline()


def test_a_file_forecasts_the_same_drivers_as_well_as_the_diagnosis_did(tmp_path: Path) -> None:
    """Twelve drivers of another simulator on a slope."""
    recordings = (
        sg.read(CASES / f"model_file_loses_decisions/{name}.csv", ring_m=150.0) for name in ("slope", "slope_same")
    )
    found, other = sg.diagnose(next(recordings), add=["harshness", "road_grade"], simulations=1), next(recordings)
    found.save(tmp_path / "s.yaml")
    base, given = of_file(sg.compare(other, model=tmp_path / "s.yaml"))
    after = errors(found.final.forecasts)["free_run_10s_m"]
    assert given["free_run_10s_m"] < 1.1 * after
    assert given["free_run_10s_m"] < base["free_run_10s_m"]


def test_an_effect_of_ones_own_is_asked_for_whatever_its_start(tmp_path: Path) -> None:
    """The recording has a width of 1.0, and the effect declares a start of 0.3."""
    about = tmp_path / "dead_zone_pkg-1.0.dist-info"
    about.mkdir()
    for name, text in ABOUT.items():
        (about / name).write_text(text)
    case = CASES / "own_effect_starts"
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join((str(tmp_path), str(case), os.environ.get("PYTHONPATH", "")))
    }
    command = [sys.executable, "-B", "-c", DIAGNOSE, str(case / "dz.csv")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ((name, is_supported, p_value, width),) = json.loads(done.stdout)
    assert (name, is_supported) == ("dead_zone", True)
    assert p_value < 0.01
    assert width == pytest.approx(1.0, abs=0.2)


def test_late_drivers_are_found_and_no_more_is_claimed() -> None:
    """Four of twelve drivers, who follow another law, react 0.7 s late: the delay is named, and so is the other law."""
    recording = sg.read(CASES / "own_late_drivers/late_jam.csv", ring_m=115.0)
    found = diagnose(recording, most=2, simulations=1)
    first = additions(found)[0]
    assert (first.name, first.is_supported) == ("reaction_delay", True)
    assert found.outcome == "not_explained"
    assert {"gain_of_idm", "gain_of_gipps"} <= {one.name for one in found.checks if one.failed}
