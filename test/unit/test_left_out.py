"""Recordings with so many drivers that a diagnosis takes some of them only."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import sugiyama_ros as sg
from benchmarks.speed.timing import jam
from sugiyama_ros.diagnosis import diagnose as search
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.fit.joint import start_model
from sugiyama_ros.fit.model import evaluate
from sugiyama_ros.fit.preparation import prepare, within
from sugiyama_ros.fit.recording import MOST_SAMPLES, some_drivers
from sugiyama_ros.page.document import document
from sugiyama_ros.trajectories.dense import tracks_of

CARS = 18


@pytest.fixture(scope="module")
def recording():
    return tracks_of(jam(CARS, 60.0))


@pytest.mark.parametrize("most", [None, 1, 100, 2_000, 2_001, MOST_SAMPLES])
@pytest.mark.parametrize(("drivers", "samples"), [(1, 50), (22, 90), (22, 91), (10_000, 750)])
def test_as_many_drivers_as_there_is_room_for(most, drivers, samples):
    who = within(most, drivers, samples)
    assert len(who) >= 1
    if most is None or drivers * samples <= most:
        assert list(who) == list(range(drivers))
    elif len(who) > 1:
        assert most / 2.5 < len(who) * samples <= most + samples


def test_the_chosen_drivers_are_predicted_as_among_all(recording):
    everybody = prepare(recording)
    most = CARS * everybody.samples // 3
    chosen = prepare(recording, most=most)
    who = within(most, CARS, everybody.samples)
    assert (chosen.drivers, chosen.left_out) == (len(who), CARS - len(who))
    assert chosen.vicinity.numbers == [everybody.vicinity.numbers[i] for i in who]
    alike = some_drivers(everybody, who)
    assert np.array_equal(chosen.ahead, alike.ahead)
    assert np.array_equal(chosen.scored, alike.scored)
    assert np.array_equal(chosen.fold, alike.fold)
    assert np.array_equal(chosen.vicinity.position_m, alike.vicinity.position_m, equal_nan=True)
    with ThreadPoolExecutor(2) as work:
        apart = evaluate(chosen, start_model(chosen, chosen.even.individual()), work)
        among = evaluate(alike, start_model(alike, alike.even.individual()), work)
    assert np.array_equal(apart.log_likelihood, among.log_likelihood, equal_nan=True)


def test_the_verdict_says_how_many_drivers_it_is_about(recording, monkeypatch):
    monkeypatch.setattr(prepare, "__defaults__", (None, len(recording) // 6))
    found = document(diagnose(recording, most=1, simulations=1, workers=2))
    assert found["drivers_left_out"] == CARS - found["vehicles"] == 15
    assert len(found["drivers"]) == 3


def test_many_drivers_are_searched_in_part_and_judged_by_all(monkeypatch):
    ring = sg.simulate(vehicles=12, ring_m=132.0, duration_s=100.0, seed=4, effects={"drag": {"c0": 0.5}}).measured
    one_leaves = ring.select((np.asarray(ring.run) != 3) | (np.asarray(ring.time_s) < 60.0))
    everybody = prepare(one_leaves)
    monkeypatch.setattr(search, "SEARCHED_DRIVERS", 4)
    monkeypatch.setattr(search, "SEARCHED_SAMPLES", 0)
    found = diagnose(one_leaves, add=["drag"], simulations=1, workers=2)
    told = document(found)
    assert (told["drivers_searched"], told["vehicles"]) == (found.searched.drivers, everybody.drivers) == (4, 12)
    assert len(found.final.fit.model.rows) == len(told["drivers"]) == everybody.drivers
    (step,) = told["verdict"]["effects"]
    assert step["parameters"]["c0"] == pytest.approx(0.5, abs=0.25)
    assert "Searched on 4 of 12 drivers" in found.summary()
