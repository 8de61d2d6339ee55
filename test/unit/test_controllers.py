"""Controllers of vehicles: the published formulas, safety, and drivers who draw the same random numbers beside them."""

import numpy as np
import pytest

from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.controllers.registry import CONTROLLERS, controlled_by, controller
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.simulation.experiment import Experiment, carry_out, set_up

PERIOD = 1.0 / 3.0


def drive(text, moments, period=PERIOD):
    """Accelerations of a controller at moments (T, 3) of gap, speed and leader's speed, one after another."""
    one = controlled_by([0], text)
    (memory,) = one.memories(period)
    return [one.controller.function(*moment, memory, period, one.values) for moment in moments]


def moments(number, seed):
    """Random gaps [m], speeds and leader's speeds [m/s]."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-1.0, 40.0, number), rng.uniform(-0.5, 12.0, (number, 2))]).tolist()


def limited(wanted, speed, period=PERIOD):
    """Acceleration to a wanted speed, within the limits of the vehicle."""
    return np.clip((wanted - speed) / period, -6.0, 1.0)


def gipps(gap, speed, leader_speed, period=PERIOD):
    """Safe speed of Gipps (1981), with b = b' = -1 m/s^2 and 2 m at standstill."""
    b = -1.0
    square = (b * period) ** 2 - b * (
        2.0 * (gap - 2.0) - max(speed, 0.0) * period - leader_speed * abs(leader_speed) / b
    )
    return max(b * period + np.sqrt(max(square, 0.0)), 0.0)


def test_constant_speed_is_the_chosen_or_the_safe_speed():
    for moment, found in zip(moments(500, 1), drive("constant_speed:target=7", moments(500, 1)), strict=True):
        assert found == pytest.approx(limited(min(7.0, gipps(*moment)), moment[1]), abs=1e-9)


def stern_target(gap, past, window):
    """Mean of the own speed in the last seconds, and up to 1 m/s more between gaps of 7 and 30 m; Stern et al."""
    last = past[-round(window / PERIOD) :]
    return sum(last) / len(last) + 1.0 * min(max((gap - 7.0) / (30.0 - 7.0), 0.0), 1.0)


def test_mean_speed_is_the_mean_of_the_last_seconds():
    past = []
    for moment, found in zip(moments(300, 2), drive("mean_speed:window=20", moments(300, 2)), strict=True):
        past.append(moment[1])
        wanted = min(stern_target(moment[0], past, 20.0), gipps(*moment))
        assert found == pytest.approx(limited(wanted, moment[1]), abs=1e-9)


def test_follower_stopper_is_the_published_one():
    """The piecewise command of Stern et al. (2018), with the constants of their experiment."""
    regions = set()
    given = moments(2000, 3)
    for (dx, v, v_lead), found in zip(given, drive("follower_stopper:target=7.5", given), strict=True):
        dv_minus, target = min(v_lead - v, 0.0), 7.5
        dx1 = 4.5 + dv_minus**2 / (2.0 * 1.5)
        dx2 = 5.25 + dv_minus**2 / (2.0 * 1.0)
        dx3 = 6.0 + dv_minus**2 / (2.0 * 0.5)
        own = min(max(v_lead, 0.0), target)
        region = int(dx > dx1) + int(dx > dx2) + int(dx > dx3)
        regions.add(region)
        command = (
            0.0,
            own * (dx - dx1) / (dx2 - dx1),
            own + (target - own) * (dx - dx2) / (dx3 - dx2),
            target,
        )[region]
        assert found == pytest.approx(limited(command, v), abs=1e-9)
    assert regions == {0, 1, 2, 3}


def test_pi_with_saturation_is_the_published_one():
    """The recursion of Stern et al. (2018), with the constants of their experiment."""
    past, command, alphas = [], None, []
    given = moments(500, 4)
    for (dx, v, v_lead), found in zip(given, drive("pi_saturation", given), strict=True):
        past.append(v)
        dx_s = max(2.0 * (v_lead - v), 4.0)
        alpha = min(max((dx - dx_s) / 2.0, 0.0), 1.0)
        beta = 1.0 - 0.5 * alpha
        command = v if command is None else command
        command = beta * (alpha * stern_target(dx, past, 38.0) + (1.0 - alpha) * v_lead) + (1.0 - beta) * command
        alphas.append(alpha)
        assert found == pytest.approx(limited(command, v), abs=1e-9)
    assert {0.0, 1.0} < set(alphas)


@pytest.mark.parametrize("text", ["constant_speed:target=12", "mean_speed:catch_up=10"])
@pytest.mark.parametrize("period", [0.1, PERIOD])
def test_the_safe_speed_is_safe_behind_hard_braking(text, period):
    """Leaders brake at random as hard as the paper's drivers can, and start again."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        one = controlled_by([0], text)
        (memory,) = one.memories(period)
        gap, speed, ahead, change = 3.0, 0.0, rng.uniform(0.0, 10.0), 0.0
        for _ in range(round(60.0 / period)):
            if rng.random() < 0.5 * period:
                change = rng.choice([-6.0, -3.0, 0.0, 1.0, 4.0])
            acceleration = one.controller.function(gap, speed, ahead, memory, period, one.values)
            gap += period * (ahead - speed)
            speed += period * acceleration
            ahead = min(max(ahead + period * change, 0.0), 12.0)
            assert gap > 1.0


def test_controllers_are_declared():
    assert list(CONTROLLERS) == ["constant_speed", "mean_speed", "follower_stopper", "pi_saturation"]
    for name, one in CONTROLLERS.items():
        assert one.name == name
        assert all((one.title, one.summary, one.source))
        for p in one.parameters:
            assert p.lower < p.default < p.upper
        free = drive(name, [(np.inf, 3.0, 0.0)])[0]
        assert free > 0.0, "a vehicle without a leader drives on"


@pytest.mark.parametrize(
    ("vehicles", "text", "reason"),
    [
        ("0", None, "--controlled: needs --controller, too"),
        (None, "constant_speed", "--controller: needs --controlled, too"),
        ("x", "constant_speed", "--controlled x: gives no numbers of vehicles; give them such as 0,7"),
        ("0", "acc", "controller 'acc': not known; choose among constant_speed, mean_speed"),
        ("0", "constant_speed:v=7", "--controller constant_speed:v=7: 'v' is not known; the parameters are target"),
        ("0", "constant_speed:target=7,target=8", "--controller .*: target is given twice; give it once"),
        ("0", "constant_speed:target", "--controller .*: target is not NAME=VALUE"),
        ("0", "constant_speed:target=fast", "--controller .*: target is fast; give 0.5 to 80 m/s"),
        ("0", "constant_speed:target=900", "--controller .*: target is 900; give 0.5 to 80 m/s"),
    ],
)
def test_what_cannot_be_controlled_is_refused(vehicles, text, reason):
    with pytest.raises(InputError, match=reason):
        controlled_by(vehicles, text, "--{}".format)


def test_a_vehicle_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="controlled: vehicle 22 is not on the road; give numbers from 0 to 21"):
        set_up(Experiment(), defaults(22), controlled_by([3, 22], "constant_speed"))
    with pytest.raises(InputError, match="controlled: vehicle -1"):
        set_up(Experiment(), defaults(22), controlled_by([-1], "constant_speed"))


def test_other_drivers_draw_the_same_random_numbers():
    free = set_up(Experiment(seed=5), defaults(22))
    held = set_up(Experiment(seed=5), defaults(22), controlled_by("0,7", "constant_speed:target=7"))
    others = np.setdiff1d(np.arange(22), [0, 7])
    for _ in range(50):
        free.step()
        held.step()
        assert np.array_equal(free.noise[others], held.noise[others])
        off = [run.road.difference(run.measure(), run.road.wrap(run.position_m)) for run in (free, held)]
        assert off[0] == pytest.approx(off[1], abs=1e-9)
        assert not held.noise[[0, 7]].any()


def test_a_controlled_vehicle_moves_as_the_controller_says():
    held = set_up(Experiment(seed=6), defaults(22), controlled_by([3], "constant_speed:target=5"))
    held.change(held.drivers + 0.0)
    for _ in range(200):
        before = held.speed[3] + held.period_s * held.acceleration[3]
        held.step()
        assert held.speed[3] == pytest.approx(before, abs=1e-12)
    assert held.speed[3] == pytest.approx(5.0, abs=1e-9)


def test_a_controller_of_ones_own_gets_its_memory():
    def counts(gap, speed, leader_speed, memory, period, p):
        memory[0] += 1.0
        return p[0] * memory[0]

    one = controller("constant_speed")
    own = type(one)("own", "own", "counts", "here", one.parameters, counts, lambda p, period: 1)
    run = set_up(Experiment(), defaults(22), Controlled((0, 4), own, np.array([0.5])))
    run.step()
    assert run.acceleration[[0, 4]].tolist() == [1.0, 1.0]


def test_one_car_of_22_takes_the_jam_away():
    """The known case: a jam of drivers whose noise fades at low speed, and one car that holds 7 m/s."""
    rows = switch_on(ROW.with_effects(defaults(22)), "speed_dependent_noise_fading", {"full_speed": 5.0})
    held = controlled_by([0], "constant_speed:target=7")
    for seed in range(3):
        experiment = Experiment(duration_s=300.0, spread=0.1, seed=seed)
        free, controlled = (carry_out(experiment, rows, one).speed[-450:] for one in (None, held))
        assert controlled.mean() > free.mean()
        assert controlled.std() < 0.5 * free.std()
