"""A calibration says when the filter does not know its own errors, and refuses to go on when it has lost a vehicle."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.calibration import soundness
from sugiyama_ros.calibration.soundness import cautions, mean_nis
from sugiyama_ros.errors import InputError


@pytest.fixture(scope="module")
def calibrated():
    return sg.calibrate(sg.simulate(vehicles=4, ring_m=45.0, duration_s=80.0, seed=2).measured)


def test_drivers_of_the_model_itself_are_sound(calibrated):
    nis = mean_nis(calibrated)
    # a mean of 234 squares of normal values has a std of sqrt(2 / 234); five of them, for four drivers
    assert nis == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 234.0))
    assert cautions(calibrated) == []


@pytest.mark.parametrize(
    ("factor", "told"),
    [(3.0, "smoother than the model's noise"), (0.2, "the model does not fit")],
)
def test_noise_that_is_wrong_is_told(calibrated, factor, told):
    rows = calibrated.rows.copy()
    rows[1, [0, 1]] *= factor
    (line,) = cautions(replace(calibrated, rows=rows))
    assert line.startswith("vehicle 1: mean NIS")
    assert told in line


def test_a_vehicle_that_the_filter_has_lost_is_an_error(calibrated):
    likelihood = calibrated.log_likelihood.copy()
    likelihood[2] = np.nan
    with pytest.raises(InputError, match="vehicle 2: the filter has lost it"):
        cautions(replace(calibrated, log_likelihood=likelihood))


def test_drivers_of_whom_nothing_is_known_are_told(calibrated, tmp_path):
    path = tmp_path / "short.csv"
    path.write_text(
        "time_s,vehicle,position_m\n" + "".join(f"{0.3 * t},{v},{30 * v + t}\n" for t in range(3) for v in (0, 1))
    )
    short = sg.calibrate(sg.read(path))
    assert cautions(short)[0] == "vehicles 0, 1: too few samples, so that no parameter is known"
    assert "inf" not in str(short)


@pytest.mark.parametrize(
    ("alone", "told"), [([0], "vehicle 0: follows nobody: "), ([0, 1], "vehicles 0, 1: follow nobody: ")]
)
def test_drivers_who_follow_nobody_are_told(calibrated, monkeypatch, alone, told):
    leader = calibrated.road.leader.copy()
    leader[:, alone] = -1
    monkeypatch.setattr(soundness, "mean_nis", lambda calibration: np.ones(len(calibration.drivers)))
    (line,) = cautions(replace(calibrated, road=SimpleNamespace(leader=leader)))
    assert line.startswith(told)


def test_a_parameter_without_an_error_is_not_identified(calibrated):
    """Its standard error is infinite."""
    vague = replace(calibrated, std=tuple({**one, "kappa_v": np.inf} for one in calibrated.std))
    cells = [cell for row in vague.table().rows for cell in row]
    assert not any("inf" in cell for cell in cells)
    assert sum(cell == "not identified" for cell in cells) >= 4
    (line,) = replace(calibrated, shared_std={"drag.c0": np.inf}).shared_sentences()
    assert line == "drag: c0 0 (not identified)"
