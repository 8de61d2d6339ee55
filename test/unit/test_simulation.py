"""Many drivers at once: the equations, the jam of the paper, collisions, and what happens without noise."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_NU, SIGMA_V, SIGMA_X, V_STAR, defaults
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.predict import linearise_chain
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, State, scene_at, step_for
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.experiment import Experiment, carry_out, changed, set_up
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

NOISES = [SIGMA_NU, SIGMA_A, SIGMA_X, SIGMA_V]


def quiet(drivers):
    p = defaults(drivers)
    p[:, NOISES] = 0.0
    return p


def ring_of_22(seed, parameters=None):
    length = np.full(22, 4.33)  # mean of the paper's Table 1
    parameters = defaults(22) if parameters is None else parameters
    return Simulator(parameters, length, platoon(length, 2.0), Road(230.0), np.random.default_rng(seed))


def test_a_step_is_eq_ssm_form():
    s = Simulator(
        defaults(2), np.full(2, 4.0), np.array([0.0, 12.0]), Road(), np.random.default_rng(1), speed=np.full(2, 5.0)
    )
    shock = np.random.default_rng(1).standard_normal((3, 2))
    before = s.position_m.copy(), s.speed.copy(), s.acceleration.copy()
    s.step()
    p, dt = defaults(), s.period_s
    assert s.position_m == pytest.approx(before[0] + dt * before[1] + p[SIGMA_X] * shock[0], abs=1e-12)
    assert s.speed == pytest.approx(before[1] + dt * before[2] + p[SIGMA_V] * shock[1], abs=1e-12)
    gap = s.position_m[1] - s.position_m[0] - 4.0
    noise = p[SIGMA_A] * shock[2]
    action = [
        mean_action(gap, s.speed[0], s.speed[1], p, ACTIONS, dt, 4),
        mean_action(np.inf, s.speed[1], 0.0, p, ACTIONS, dt, 4),
    ]
    assert s.acceleration == pytest.approx(action + noise, abs=1e-12)
    s.step()
    assert s.noise == pytest.approx(
        p[RHO] * noise + p[SIGMA_A] * np.random.default_rng(1).standard_normal((6, 2))[5], abs=1e-12
    )


def test_a_jam_is_the_papers():
    """Bounds from the experiment and from an independent implementation: V_avg 5.9 m/s, wave -6.5 m/s."""
    for seed in range(3):
        run = simulate(ring_of_22(seed), 250.0)
        assert run.collisions == ()
        speed, position = run.speed[300:], run.position_m[300:]
        assert 5.5 <= speed.mean() <= 6.3
        assert speed.min(axis=1).mean() < 1.0
        assert 9.5 < speed.max(axis=1).mean() < 11.0
        assert -7.0 <= wave_speed(position, speed, 230.0, run.dense.period_s) <= -6.0


def wave_speed(position, speed, circumference, period):
    """Slope [m/s] of the place where traffic is slowest, followed around the ring."""
    angle = 2.0 * np.pi * position / circumference
    slow = np.exp(-speed)
    place = np.unwrap(np.angle((slow * np.exp(1j * angle)).sum(axis=1))) * circumference / (2.0 * np.pi)
    return np.polyfit(period * np.arange(len(place)), place, 1)[0]


def test_measurement_noise_has_its_std():
    run = simulate(ring_of_22(3), 250.0)
    error = run.dense.road.difference(run.dense.position_m, run.position_m)
    n = error.size
    # the sample variance of n normal values has a relative std of sqrt(2 / n); five of these are allowed
    assert error.var() == pytest.approx(0.263**2, rel=5 * np.sqrt(2 / n))


def test_without_noise_the_filters_prediction_is_the_simulation():
    """The filter starts from the exact state of a chain. Its next mean equals the simulator's next state."""
    s = ring_of_22(0, quiet(22))
    size = STATE * CHAIN
    none, nothing = np.empty(0, np.int64), np.empty(0)
    scene = scene_at(s.period_s, s.road.circumference_m)
    for _ in range(300):
        mean = np.zeros(size)
        chain = np.array([21, 0, 1])  # across the place where the ring begins
        mean[0::4] = s.position_m[chain] + [0.0, 230.0, 230.0]
        mean[1::4] = s.speed[chain]
        known = np.full(CHAIN, MOVING)
        rows = np.stack([s.parameters[0]] * CHAIN)
        state, drivers = State(mean, np.zeros((size, size)), known), Drivers(rows, none, nothing, nothing)
        step = step_for(state, drivers, s.length_m[chain], scene, ACTIONS)
        linearise_chain(step)
        next_mean = step.out.next_mean
        s.step()
        assert next_mean[[0, 4]] == pytest.approx(s.position_m[chain[:2]] + [0.0, 230.0], abs=1e-9)
        assert next_mean[[1, 5]] == pytest.approx(s.speed[chain[:2]], abs=1e-9)
    assert np.ptp(s.speed) > 1.0


def test_a_collision_ends_the_run_and_is_reported():
    p = quiet(2)
    p[1, V_STAR] = 0.5
    start = np.array([0.0, 6.0])
    s = Simulator(p, np.full(2, 4.0), start, Road(), np.random.default_rng(0), speed=np.array([14.0, 0.5]))
    run = simulate(s, 20.0)
    assert [(c.vehicle, c.leader) for c in run.collisions] == [(0, 1)]
    assert run.dense.duration_s == pytest.approx(run.collisions[0].time_s)
    assert run.dense.duration_s < 20.0


def test_translating_the_ring_changes_nothing():
    length = np.full(5, 4.0)
    runs = [
        simulate(
            Simulator(defaults(5), length, platoon(length, 3.0) + shift, Road(60.0), np.random.default_rng(4)), 30.0
        )
        for shift in (0.0, 17.0)
    ]
    assert runs[1].speed == pytest.approx(runs[0].speed, abs=1e-9)
    moved = runs[0].dense.road.difference(runs[1].position_m, runs[0].position_m + 17.0)
    assert moved == pytest.approx(np.zeros_like(moved), abs=1e-9)


@pytest.mark.parametrize("ring_m", [60.0, 0.0])
def test_the_truth_goes_into_a_bag_and_comes_back(tmp_path: Path, ring_m: float) -> None:
    rows = changed(ROW.with_effects(defaults(3)), {}, {"drag": {"c0": 0.3}})
    run = carry_out(Experiment(ring_m=ring_m, duration_s=20.0, spread=0.1, length_m=(4.0, 5.0, 6.0)), rows)
    run.save(tmp_path / "a.mcap")
    truth = read_truth(tmp_path / "a.mcap")
    assert truth is not None
    assert np.array_equal(truth.time_s, np.round(run.dense.time_s, 9))
    for name in ("vehicle", "position_m", "speed", "acceleration", "gap_m"):
        assert np.array_equal(getattr(truth, name), getattr(run.truth, name)), name
    assert [(d.vehicle, d.parameters) for d in truth.drivers] == [(d.vehicle, d.parameters) for d in run.truth.drivers]
    assert truth.drivers[0].parameters["drag.c0"] == 0.3
    assert truth.drivers[0].parameters["v_star"] == run.parameters[0, V_STAR]
    # the gap at the start, and on the ring the gaps and lengths make up the circumference
    assert truth.gap_m[0, :2] == pytest.approx(2.0)
    assert truth.gap_m[:, 2] == pytest.approx(np.inf if ring_m == 0.0 else 60.0 - 15.0 - truth.gap_m[:, :2].sum(axis=1))
    assert np.array_equal(read_tracks(tmp_path / "a.mcap").dense().position_m, run.dense.position_m)
    run.save(tmp_path / "a.csv")
    with pytest.raises(InputError):
        read_truth(tmp_path / "a.csv")


def test_drivers_who_are_changed_drive_otherwise_from_then_on() -> None:
    def begun() -> Simulator:
        return set_up(Experiment(ring_m=200.0, start="equal"), ROW.with_effects(defaults(3)))

    usual, other = begun(), begun()
    rows = other.drivers.copy()
    rows[1, V_STAR] = 5.0
    other.change(rows)
    for simulator in (usual, other):
        simulator.step()
    assert np.array_equal(usual.position_m, other.position_m)  # the acceleration of the first period was decided before
    assert usual.acceleration[0] == other.acceleration[0]
    for _ in range(60):
        for simulator in (usual, other):
            simulator.step()
    assert other.speed[1] < 6.0 < usual.speed[1]
    rows[1, V_STAR] = 500.0
    with pytest.raises(InputError, match="out of bounds"):
        other.change(rows)
    assert other.drivers[1, V_STAR] == 5.0
