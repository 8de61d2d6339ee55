"""Every car-following law: well declared, finite everywhere, and equal to the closed forms of its source."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.effects.control import law_acceleration
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, LAWS, RIVALS, law, number_of

speeds = st.floats(0.0, 12.0)
EVERY = pytest.mark.parametrize("name", RIVALS)
#: Gipps' free acceleration first grows with the speed.
FALLING = pytest.mark.parametrize("name", [name for name in RIVALS if name != "gipps"])


def default(name):
    return np.array([p.default for p in law(name).parameters])


def rows(name):
    """Parameters anywhere within their bounds."""
    return st.tuples(*(st.floats(p.lower, p.upper) for p in law(name).parameters)).map(
        lambda values: np.array(values, dtype=np.float64)
    )


def acceleration(name, gap, speed, leader_speed, p):
    """Acceleration from a driver's row, as the filters compute it."""
    row = np.zeros(ROW.width)
    row[ROW.law], row[ROW.law_places[name]] = number_of(name), p
    return law_acceleration(gap, speed, leader_speed, row)


@pytest.mark.parametrize("name", list(LAWS))
def test_a_law_is_declared(name):
    one = LAWS[name]
    assert one.name == name
    assert one.title
    assert one.summary
    assert one.source
    for p in one.parameters:
        assert p.lower < p.default < p.upper
        assert p.unit
        assert p.description


def test_laws_are_looked_up_by_name():
    assert number_of("adaptive_seek") == ADAPTIVE_SEEK
    assert tuple(LAWS)[number_of("idm")] == "idm"
    with pytest.raises(InputError, match="law 'wiedemann': not known; choose among adaptive_seek, idm"):
        law("wiedemann")


def test_adaptive_seek_is_the_papers_driver():
    p = defaults()
    assert law("adaptive_seek").function(4.0, 6.0, 5.0, p) == mean_action(4.0, 6.0, 5.0, p, ACTIONS, 1.0 / 3.0, 4)


@EVERY
def test_a_row_leads_to_the_law_of_its_number(name):
    p = default(name)
    assert acceleration(name, 7.0, 5.0, 4.0, p) == law(name).function(7.0, 5.0, 4.0, p)


def test_a_number_that_no_law_has_gives_no_acceleration():
    row = np.zeros(ROW.width)
    row[ROW.law] = len(LAWS)
    assert math.isnan(law_acceleration(7.0, 5.0, 4.0, row))


@EVERY
@settings(deadline=None)  # the first call compiles
@given(gap=st.floats(-5.0, 100.0), speed=speeds, leader_speed=speeds, by=st.floats(0.01, 5.0), data=st.data())
def test_a_larger_gap_never_slows_and_a_faster_leader_never_does(name, gap, speed, leader_speed, by, data):
    p, function = data.draw(rows(name)), law(name).function
    here = function(gap, speed, leader_speed, p) - 1e-12
    assert function(gap + by, speed, leader_speed, p) >= here
    assert function(gap, speed, leader_speed + by, p) >= here


@FALLING
@settings(deadline=None)  # the first call compiles
@given(gap=st.floats(-5.0, 100.0), speed=speeds, share=st.floats(0.0, 2.0), by=st.floats(0.01, 5.0), data=st.data())
def test_a_faster_driver_accelerates_less(name, gap, speed, share, by, data):
    """For the IDM, the leader has at most twice the speed; beyond that, its wanted gap may shrink with the speed."""
    p, function = data.draw(rows(name)), law(name).function
    leader_speed = share * speed
    assert function(gap, speed + by, leader_speed, p) <= function(gap, speed, leader_speed, p) + 1e-12


@EVERY
@settings(deadline=None)  # the first call compiles
@given(
    gap=st.floats(-1e300, 1e300) | st.sampled_from([math.inf, -math.inf, 0.0, 5e-324]),
    speed=st.floats(-1e150, 1e150),
    leader_speed=st.floats(-1e150, 1e150),
    data=st.data(),
)
def test_every_acceleration_is_one_that_a_driver_can_choose(name, gap, speed, leader_speed, data):
    p = data.draw(rows(name))
    assert ACTIONS[0] <= law(name).function(gap, speed, leader_speed, p) <= ACTIONS[-1]


# --- closed forms ----------------------------------------------------------------------------------------------------


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 9.9))
def test_idm_rests_in_its_equilibrium_gap(speed):
    """Treiber, Hennecke and Helbing (2000): s_e = (s0 + v T) / sqrt(1 - (v / v0)^4)."""
    v0, T, s0, _, _ = default("idm")
    gap = (s0 + speed * T) / math.sqrt(1.0 - (speed / v0) ** 4)
    assert law("idm").function(gap, speed, speed, default("idm")) == pytest.approx(0.0, abs=1e-12)


def test_idm_is_its_formula():
    (v0, T, s0, a, b), idm = default("idm"), law("idm").function
    wanted = s0 + 7.0 * T + 7.0 * (7.0 - 5.0) / (2.0 * math.sqrt(a * b))
    expected = a * (1.0 - (7.0 / v0) ** 4 - (wanted / 12.0) ** 2)
    assert idm(12.0, 7.0, 5.0, default("idm")) == pytest.approx(expected, abs=1e-12)
    assert idm(math.inf, 7.0, 0.0, default("idm")) == pytest.approx(a * (1.0 - (7.0 / v0) ** 4), abs=1e-12)


@pytest.mark.parametrize("gap", [0.0, -0.01, -5.0, -math.inf])
def test_idm_brakes_inside_another_vehicle_even_if_it_wants_no_gap(gap):
    p = default("idm")
    p[2] = 0.0
    assert law("idm").function(gap, 0.0, 0.0, p) == ACTIONS[0]


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 60.0))
def test_fvdm_rests_at_its_optimal_velocity(gap):
    (_, relative, V1, V2, C1, C2), fvdm = default("fvdm"), law("fvdm").function
    speed = V1 + V2 * math.tanh(C1 * gap - C2)
    assert fvdm(gap, speed, speed, default("fvdm")) == pytest.approx(0.0, abs=1e-12)
    assert fvdm(gap, speed, speed - 0.7, default("fvdm")) == pytest.approx(-0.7 * relative, abs=1e-12)


def test_fvdm_without_a_leader_goes_to_its_highest_optimal_velocity():
    kappa, _, V1, V2, _, _ = default("fvdm")
    found = law("fvdm").function(math.inf, 8.0, 0.0, default("fvdm"))
    assert found == pytest.approx(kappa * (V1 + V2 - 8.0), abs=1e-12)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.5, 9.0))
def test_gipps_rests_where_the_safe_speed_is_its_own(speed):
    """Gipps (1981) with equal braking: v = -b tau + sqrt(b^2 tau^2 + b (2 s - v tau) + v^2) gives s = 1.5 v tau."""
    v0, _, _, _, tau, s0 = p = default("gipps")
    gap = s0 + 1.5 * speed * tau
    assert speed < v0
    assert law("gipps").function(gap, speed, speed, p) == pytest.approx(0.0, abs=1e-11)


def test_gipps_on_a_free_road_is_its_formula():
    v0, a, _, _, tau, _ = p = default("gipps")
    expected = 2.5 * a * (1.0 - 4.0 / v0) * math.sqrt(0.025 + 4.0 / v0)
    assert law("gipps").function(math.inf, 4.0, 0.0, p) == pytest.approx(expected, abs=1e-12)
    assert law("gipps").function(math.inf, v0, 0.0, p) == pytest.approx(0.0, abs=1e-12)
    assert tau > 0.0


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 60.0))
def test_ovm_rests_at_its_optimal_velocity(gap):
    _, V, c, g = p = default("ovm")
    speed = V * (math.tanh(c * (gap - g)) + math.tanh(c * g))
    assert law("ovm").function(gap, speed, 0.3, p) == pytest.approx(0.0, abs=1e-12)
    assert law("ovm").function(0.0, 0.0, 0.0, p) == pytest.approx(0.0, abs=1e-12)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 9.9))
def test_newell_rests_a_time_shift_behind(speed):
    v0, tau, d, _ = p = default("newell")
    assert law("newell").function(d + tau * speed, speed, 0.0, p) == pytest.approx(0.0, abs=1e-12)
    assert law("newell").function(math.inf, v0, 0.0, p) == 0.0


def test_helly_is_its_formula():
    c_v, c_s, d, T = p = default("helly")
    expected = c_v * (4.0 - 5.0) + c_s * (9.0 - (d + T * 5.0))
    assert law("helly").function(9.0, 5.0, 4.0, p) == pytest.approx(expected, abs=1e-12)
    assert law("helly").function(math.inf, 5.0, 0.0, p) == 0.0
