"""Drivers of another law: simulated, diagnosed with the law as the base model, and kept in a model file."""

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.driver.parameters import SIGMA_A, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import drive_by, read_model
from sugiyama_ros.laws.registry import LAWS, number_of
from sugiyama_ros.simulation.experiment import Experiment, carry_out

_IDM = {p.name: p.default for p in LAWS["idm"].parameters}


def followers(vehicles, delay_s, seed, effect="reaction_delay"):
    """Drivers of the IDM on a ring, perhaps with a reaction time."""
    rows = np.array([drive_by(row, "idm", _IDM) for row in ROW.with_effects(defaults(vehicles))])
    rows[:, SIGMA_A] = 0.2
    if delay_s:
        rows = switch_on(rows, effect, {"delay": delay_s})
    return carry_out(Experiment(ring_m=20.0 * vehicles, start="equal", seed=seed), rows).measured


@pytest.fixture(scope="module")
def delayed():
    return sg.diagnose(followers(8, 0.6, 4), law="idm")


def test_a_delay_of_drivers_of_the_idm_is_found(delayed):
    first = delayed.steps[0].new[0]
    assert first.mechanism == "reaction_delay"
    assert "IDM(gap, v, v_lead)" in delayed.summary()
    assert all(entry.name != "idm" for entry in delayed.laws)


def test_a_model_file_keeps_the_law(delayed, tmp_path):
    delayed.save(tmp_path / "model.yaml")
    rows = read_model(tmp_path / "model.yaml").rows
    fitted = delayed.final.fit.model.rows
    assert (rows[:, ROW.law] == number_of("idm")).all()
    assert rows[:, ROW.law_places["idm"]] == pytest.approx(fitted[:, ROW.law_places["idm"]])


def test_what_is_added_by_name_competes_with_its_other_forms_and_claims_no_more():
    found = sg.diagnose(followers(8, 0.6, 4, "reaction_delay_all"), law="idm", add=["reaction_delay"])
    names = {e.name for e in found.rounds[0].gains}
    assert {"reaction_delay", "reaction_delay_all"} <= names
    assert any(check.name.startswith("gain_of_reaction_delay_") for check in found.checks)
    assert any(check.name.startswith("left_for_") for check in found.checks)
    assert "ther effects were not fitted" in found.summary()


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [("idn", {}, "idn"), ("idm", {}, "give"), ("idm", {**_IDM, "T": -1.0}, "give")],
)
def test_what_is_no_law_is_refused(name, values, says):
    with pytest.raises(InputError, match=says):
        drive_by(ROW.with_effects(defaults(1))[0], name, values)
