"""The critic's bank: it names what is missing, fits its strength, knows what was added, and says when it is settled."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import KAPPA_V, defaults, population
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.bank import BASE, SETTLED_S, Bank, variants_of
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

DRIVERS, RING_M, DT = 4, 60.0, 1.0 / 3.0


def judged(effects, base=None, seconds=100.0, speed=6.0):
    """The bank after a recording of drivers with some effects, and the times at which it was settled."""
    p = defaults(DRIVERS)
    p[:, KAPPA_V] = 0.3
    rows = ROW.with_effects(p)
    for name, values in effects.items():
        rows = switch_on(rows, name, values)
    length, road = np.full(DRIVERS, 4.33), Road(RING_M)
    start = evenly(length, road)
    simulator = Simulator(rows, length, start, road, np.random.default_rng(4), speed=np.full(DRIVERS, speed))
    run = simulate(simulator, seconds)
    assert not run.collisions
    t = run.dense
    chains = [chain_behind(t, v) for v in range(DRIVERS)]
    row = ROW.with_effects(population())
    row[KAPPA_V] = 0.3
    bank, settled = Bank(DT, road, switch_on(row, *base) if base else row, 120.0), []
    for v in range(DRIVERS):
        bank.meet(v)
    for k in range(len(t.position_m)):
        bank.forget()
        for v, chain in enumerate(chains):
            behind = t.position_m[k, v - 1], (v - 1) % DRIVERS, 4.33
            bank.step(v, chain.position_m[k], chain.identity[k], chain.length_m[k], k * DT, behind)
        if bank.is_settled:
            settled.append(k * DT)
    return bank, settled


def test_a_slope_of_the_road_is_named_and_its_strength_is_fitted():
    place = {"centre": 22.5, "width": 30.0}
    bank, _ = judged({"road_grade": {"grade": 0.12, **place}})
    assert bank.names[int(bank.weights.argmax())] == "road_grade"
    # the bank begins with a sixth of it
    assert bank.fitted["road_grade"]["grade"] == pytest.approx(0.12, rel=0.35)
    known, _ = judged({"road_grade": {"grade": 0.12, **place}}, ("road_grade", {"grade": 0.12, **place}), 15.0)
    assert known.effects == ("road_grade",)
    assert "road_grade" not in known.names
    assert known.names[int(known.weights.argmax())] == BASE


def test_without_an_effect_the_base_model_leads_and_this_gets_settled():
    bank, settled = judged({}, seconds=150.0)
    assert bank.names[int(bank.weights.argmax())] == BASE
    assert settled
    assert settled[0] >= SETTLED_S


def test_an_effect_of_a_place_takes_no_part_on_an_open_road():
    assert variants_of("slow_patch", Road()) == ()
    assert len({v["centre"] for v in variants_of("slow_patch", Road(230.0))}) == 4


def test_a_driver_who_leaves_is_forgotten_but_what_they_said_counts():
    bank, _ = judged({}, seconds=15.0)
    samples, gains = bank.samples, bank.gains
    bank.leave(1)
    assert bank.vehicles == [0, 2, 3]
    assert bank.samples == samples
    assert bank.gains == pytest.approx(gains)
    bank.meet(1)
    for k in range(2):
        bank.step(1, [0.0 + 2.0 * k, 20.0 + 2.0 * k, np.nan], [1, 2, -1], [4.33, 4.33, 0.0], k * DT)
    # a filter that begins anew has no speed yet, so its first samples do not count
    assert bank.samples == samples
