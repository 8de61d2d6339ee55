"""Drivers on networks: what they see, how they decide, and what is learnt from their tracks."""

from dataclasses import replace

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.driver.line import TIME_GAP_S, attention, time_over, time_to_line
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_NU, V_STAR, defaults, population
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.chain import NOT_ADAPTED
from sugiyama_ros.filters.extract import drives
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.road import Road
from sugiyama_ros.roads.examples import crossing, merge, roundabout
from sugiyama_ros.roads.network import Lanelet, Network, Signal
from sugiyama_ros.simulation.junction import JunctionSimulator, Traveller, demand, simulate_junction
from sugiyama_ros.simulation.scenes import simulate_scene
from sugiyama_ros.simulation.simulator import Clock, Simulator
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.stretches import stretches

CLOCK = Clock(0.2)


def drivers(count, rng):
    rows = defaults(count)
    rows[:, V_STAR] = rng.normal(11.0, 1.0, count)
    rows[:, KAPPA_V] = np.exp(rng.normal(np.log(0.4), 0.2, count))
    rows[:, SIGMA_NU] = 0.1
    return ROW.with_effects(rows)


def run_on(network, count, per_hour, seed, effect=None, duration_s=2000.0, **values):
    rng, paths = np.random.default_rng(seed), network.ways()
    rows = drivers(count, rng)
    if effect:
        rows = switch_on(rows, effect, values)
    come = demand(np.full(len(paths), per_hour / len(paths)), rows, rng)
    return simulate_junction(JunctionSimulator(network, paths, come, rng, CLOCK), duration_s)


def one_lane(signal=None, length_m=400.0):
    lane = Lanelet("lane", np.array([0.0, length_m]), np.zeros(2))
    return Network((lane,), (), () if signal is None else (signal,))


def test_the_time_to_a_line_is_that_of_an_even_acceleration():
    gap, speed = 12.0, 3.0
    time = time_to_line(gap, speed)
    assert speed * time + 0.5 * 4.0 * time**2 == pytest.approx(gap, rel=1e-12)
    assert time_to_line(0.0, speed) == 0.0


def test_attention_comes_with_who_goes_first_and_goes_with_them():
    at_line = 1.0, 0.0
    through = time_over(1.0 + 6.0, 0.0, 1.5)
    assert attention(*at_line, through + TIME_GAP_S + 3.0, 20.0, TIME_GAP_S) < 1e-3
    assert attention(*at_line, through + TIME_GAP_S - 3.0, 20.0, TIME_GAP_S) > 0.999
    # they have left before the driver comes
    assert attention(40.0, 8.0, 0.3, 0.9, TIME_GAP_S) < 1e-2
    # nobody can stop any more, or there is no line
    assert attention(3.0, 12.0, 0.0, np.inf, TIME_GAP_S) < 1e-3
    assert attention(np.inf, 8.0, 0.0, np.inf, TIME_GAP_S) == 0.0


def test_a_road_without_lines_is_the_road_of_one_lane():
    """Simulated places and speeds, and everything that a filter says, are those of the simulator of one lane."""
    rng, count = np.random.default_rng(5), 6
    rows = drivers(count, rng)
    network, start = one_lane(length_m=2000.0), 20.0 * np.arange(count)
    come = [Traveller(0, row, 0.0) for row in rows]
    ours = JunctionSimulator(network, [network.path([0])], come, np.random.default_rng(1), CLOCK)
    ours.entered[:] = True
    ours.place[:], ours.speed[:] = start, 8.0
    theirs = Simulator(
        rows, np.full(count, 4.5), start, Road(), np.random.default_rng(1), speed=np.full(count, 8.0), clock=CLOCK
    )
    for _ in range(200):
        ours.step()
        theirs.step()
    assert np.min(ours.speed) > 1.0
    np.testing.assert_allclose(ours.place, theirs.position_m, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ours.speed, theirs.speed, rtol=0.0, atol=1e-9)


def test_a_straight_road_where_nobody_crosses_gives_the_numbers_of_the_road():
    run = run_on(one_lane(), 12, 1200.0, 3)
    seen = run.measured
    names = ("line_m", "arrive_s", "clear_s", "curvature_per_m", "leader_shift_m")
    plain = sg.calibrate(replace(seen, **dict.fromkeys(names)))
    ours = sg.calibrate(seen)
    np.testing.assert_allclose(
        ours.to_frame()[["v_star", "kappa_v"]], plain.to_frame()[["v_star", "kappa_v"]], rtol=1e-9
    )


@pytest.mark.parametrize(
    ("network", "per_hour"),
    [(merge(), 1200.0), (roundabout(), 1200.0), (crossing(), 800.0), (crossing(cycle_s=60.0), 800.0)],
)
def test_everybody_comes_through_and_nobody_collides(network, per_hour):
    run = run_on(network, 100, per_hour, 7)
    assert run.arrived.all()
    assert not run.collisions
    assert run.longest_stop_s < 10.0
    # they do meet: without the lines, they collide
    reckless = run_on(network, 100, per_hour, 7, "ignored_yield", share=1.0)
    assert len(reckless.collisions) > 0 or network.signals


@pytest.mark.parametrize(
    ("scene", "count", "seed"), [("crossing", 22, 8011), ("signals", 60, 8006), ("merge", 60, 8006)]
)
def test_a_scene_keeps_who_led_whom(scene, count, seed, tmp_path):
    """Measured gaps of vehicles that stand are below zero at times, and measured places then name another leader."""
    run = simulate_scene(scene, defaults(count), seed, duration_s=250.0, period_s=1 / 3)
    write_tracks(run.measured, tmp_path / "a.csv")
    write_tracks(run.measured, tmp_path / "a.parquet")
    assert (gaps(run.measured) < 0.0).mean() > 0.003
    for tracks in (run.measured, sg.read(tmp_path / "a.csv"), sg.read(tmp_path / "a.parquet")):
        led = {
            (tracks.vehicle.at(k), round(float(tracks.time_s[k]), 6)): tracks.vehicle.at(int(j)) if j >= 0 else ""
            for k, j in enumerate(tracks.leader_row.tolist())
        }
        for i, time, j in zip(run.rows.vehicle, run.rows.time_s, run.seen.leader, strict=True):
            assert led[str(i), round(float(time), 6)] == (str(j) if j >= 0 else "")


def test_a_run_in_which_nobody_comes_says_how_long_it_must_be():
    with pytest.raises(InputError, match=r"^duration: 1 s: nobody comes so early; give at least (\d+) s$") as said:
        simulate_scene("roundabout", defaults(22), 0, duration_s=1.0)
    enough = float(str(said.value).split()[-2])
    assert len(simulate_scene("roundabout", defaults(22), 0, duration_s=enough).measured) > 10


def test_nobody_drives_through_a_red_signal():
    red = Signal("lane", 200.0, np.array([0.0, 40.0]), np.array([True, False]), 60.0)
    run = run_on(one_lane(red), 20, 600.0, 2)
    crossed = []
    for i in range(20):
        own = run.rows.vehicle == i
        front = run.place_m[own] + 0.5 * 4.5
        crossed.append(run.rows.time_s[own][np.searchsorted(front, 201.0)])
    assert run.arrived.all()
    assert (np.mod(crossed, 60.0) >= 40.0 - 0.3).all()


def test_the_online_filter_is_the_batch_filter_at_a_junction():
    run = run_on(roundabout(), 20, 900.0, 4)
    drive = max(drives(run.measured), key=lambda d: np.isfinite(d.chain.around[:, 3]).sum())
    row = run.travellers[int(drive.stretch.vehicle)].row
    chain, batch = drive.chain, filter_chain(drive.chain, row)
    online = OnlineFilter(
        chain.period_s, Road(), row, population(), NOT_ADAPTED, None, vehicles=chain.position_m.shape[1]
    )
    steps = [
        online.step(
            chain.position_m[k],
            chain.identity[k],
            chain.length_m[k],
            chain.start_s + k * chain.period_s,
            lines=tuple(chain.around[k, 3:]),
        )
        for k in range(len(chain.position_m))
    ]
    ours = np.array([one.innovation_m for one in steps])
    assert np.isfinite(chain.around[:, 3]).sum() > 5
    # a small difference of rounding grows where the attention changes fast
    np.testing.assert_allclose(ours, batch.innovation_m, rtol=0.0, atol=1e-7)


def test_a_leader_from_another_way_is_ahead_on_the_own_way():
    """On a roundabout, places of vehicles from different arms differ by an offset; gaps must not jump with it."""
    run = run_on(roundabout(), 40, 1200.0, 6)
    led = 0
    for stretch in stretches(run.measured):
        gap = stretch.position_m[:, 1] - stretch.position_m[:, 0] - 4.5
        gap = gap[np.isfinite(gap)]
        led += len(gap)
        assert (gap > -1.5).all()
    assert led > 1000


@pytest.mark.parametrize(
    ("effect", "network", "values"),
    [
        ("curve_speed", roundabout(), {"lateral": 2.0}),
        ("ignored_yield", roundabout(), {"share": 0.98}),
        ("late_start", crossing(cycle_s=40.0), {"delay": 1.5}),
        ("accepted_gap", roundabout(), {"longer": -2.0}),
        ("blind_sector", roundabout(), {"sight": 6.0}),
    ],
)
def test_the_filter_prefers_the_effect_that_is_there(effect, network, values):
    run = run_on(network, 40, 900.0, 8, effect, **values)
    gain = 0.0
    for drive in drives(run.measured):
        row = run.travellers[int(drive.stretch.vehicle)].row
        without = row.copy()
        without[ROW.places[effect]] = 0.0
        with_it, base = (
            float(np.nansum(filter_chain(drive.chain, r).sample_log_likelihood[drive.scored])) for r in (row, without)
        )
        gain += with_it - base
    assert gain > 5.0
