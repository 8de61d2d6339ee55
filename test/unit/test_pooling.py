"""Many drivers over short tracks: classes, recordings with noises of their own, goals, and drivers who are held out."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import yaml

import sugiyama_ros as sg
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults, index
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.goals import GoalFilter
from sugiyama_ros.fit.classes import find_classes
from sugiyama_ros.fit.goals import Goal, goals_of, read_goal
from sugiyama_ros.fit.held_out_drivers import chosen, predict_held_out
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Clock, Simulator, evenly, simulate
from sugiyama_ros.studies.driver_types import adjusted_rand
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of

ESTIMATED = tuple(index(name) for name in ("sigma_nu", "sigma_a", "v_star", "kappa_v"))
KINDS = np.array([[8.0, 0.5, 0.15], [14.0, 0.12, 0.5]])
NOISES_M = (0.1, 0.4)
CARS, SEEN_S, PERIOD_S = 16, 15.0, 0.2
EXIT = Goal("exit", place=500.0, speed=6.0)


def seen(position_m, recording, lane, begins_s=0.0):
    """Rows of vehicles (T, N) in one lane."""
    samples, cars = position_m.shape
    names = [f"{lane}{c}" for c in range(cars)]
    return {
        "recording": [recording] * position_m.size,
        "lane": [lane] * position_m.size,
        "vehicle": np.repeat(names, samples).tolist(),
        "time_s": np.tile(begins_s + PERIOD_S * np.arange(samples), cars),
        "s_m": position_m.T.ravel(),
        "length_m": np.full(position_m.size, 4.5),
    }


def tracks_of_rows(parts):
    texts = {k: labels_of([t for part in parts for t in part[k]]) for k in ("recording", "lane", "vehicle")}
    numbers = {k: np.concatenate([part[k] for part in parts]) for k in ("time_s", "s_m", "length_m")}
    return of_columns({**texts, **numbers}, About())


@pytest.fixture(scope="module")
def short():
    """Tracks of 15 s of drivers of two kinds, in two recordings with other noises; and the kind of each driver."""
    parts, kinds = [], {}
    for number, noise_m in enumerate(NOISES_M):
        rng = np.random.default_rng(20 + number)
        kind = rng.permutation(np.arange(CARS) % 2)
        rows = defaults(CARS)
        rows[:, [V_STAR, KAPPA_V, SIGMA_A]], rows[:, SIGMA_NU] = KINDS[kind], noise_m
        length, road = np.full(CARS, 4.5), Road(180.0)
        start = Simulator(rows, length, evenly(length, road), road, rng, clock=Clock(PERIOD_S))
        run = simulate(start, 40.0 + SEEN_S)
        assert not run.collisions
        way = road.unwrap(run.dense.position_m)[round(40.0 / PERIOD_S) :]
        way = way + 180.0 * np.ceil((way[0, 0] - way[0]) / 180.0)  # one behind the other
        order = np.argsort(way[0])
        parts.append(seen(way[:, order], f"r{number}", f"{'ab'[number]}"))
        kinds |= {f"{'ab'[number]}{c}": int(k) for c, k in enumerate(kind[order])}
    return tracks_of_rows(parts), kinds


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as some:
        yield some


def test_classes_are_found_on_short_tracks_with_the_noise_of_each_recording(short, tmp_path):
    tracks, kinds = short
    found = sg.calibrate(tracks, classes=2)
    truth = [kinds[str(d.vehicle)] for d in found.drivers]
    assert len(truth) == 2 * (CARS - 1)
    assert adjusted_rand(np.array(truth), found.classes.probability.argmax(axis=1)) > 0.8
    cautious = found.classes.rows[np.argmax(found.classes.rows[:, KAPPA_V])]
    assert cautious[V_STAR] == pytest.approx(8.0, rel=0.1)
    for noise_m, name in zip(NOISES_M, ("r0", "r1"), strict=True):
        of_recording = {row[SIGMA_NU] for row, d in zip(found.rows, found.drivers, strict=True) if d.recording == name}
        assert list(of_recording) == pytest.approx([noise_m], rel=0.15)
    found.save(tmp_path / "types.yaml")
    model = read_model(tmp_path / "types.yaml")
    # somebody new is expected to be as these drivers are
    median, log_std = model.population.parameters["kappa_v"]
    assert model.rows_of(np.array([999]))[0, KAPPA_V] == median
    assert log_std > 0.3


def test_held_out_drivers_choose_the_number_of_classes(short, work):
    """Two kinds of drivers: a second class predicts unseen drivers better, and each driver alone is predicted worse."""
    tracks, _ = short
    found = predict_held_out(prepare(tracks, most=None), ESTIMATED, 3, work, seed=0)
    assert [one.name for one in found] == ["1 class", "2 classes", "3 classes", "population", "each alone"]
    assert chosen(found) == 2
    gains = {one.name: one.document(found[0]) for one in found}
    assert gains["2 classes"]["whole"] > 2.0 * gains["2 classes"]["whole_std"]
    assert gains["each alone"]["later"] < gains["2 classes"]["later"]


def test_drivers_on_tracks_are_draws_from_one_population(short):
    tracks, _ = short
    together, alone = sg.calibrate(tracks), sg.calibrate(tracks, regularise=False)
    assert together.population is not None
    assert alone.population is None
    spread = [np.log(one.rows[:, KAPPA_V]).std() for one in (together, alone)]
    assert spread[0] < spread[1]


def approach(rng, leaves):
    """A driver and two vehicles ahead on the way to the exit, until 10 m before it."""
    rows = np.tile(ROW.with_effects(defaults(1)), (3, 1))
    rows[:, V_STAR], rows[:, KAPPA_V] = 14.0, 0.4
    if leaves:
        rows[:1] = switch_on(rows[:1], "goal_ahead", EXIT.values)
    position = np.array([380.0, 420.0, 460.0]) + rng.uniform(-5.0, 5.0, 3)
    start = Simulator(rows, np.full(3, 4.5), position, Road(), rng, speed=np.full(3, 13.0), clock=Clock(PERIOD_S))
    way = simulate(start, 15.0).dense.position_m
    return way[: int(np.argmax(way[:, 0] > EXIT.place - 10.0)) or len(way)]


@pytest.fixture(scope="module")
def exits():
    """Drivers of whom every third leaves on the right lane and nobody on the left one; the exit itself is not seen."""
    parts, leaves = [], {}
    rng = np.random.default_rng(5)
    for number in range(24):
        lane = ("right", "left")[number % 2]
        wants = lane == "right" and number % 3 == 0
        way = approach(rng, wants)
        part = seen(way, "r", lane, 100.0 * number)
        part["vehicle"] = [f"{number}-{name}" for name in part["vehicle"]]
        parts.append(part)
        leaves[f"{number}-{lane}0"] = wants
    return tracks_of_rows(parts), leaves


def test_goals_are_told_by_how_drivers_slow_down(exits, tmp_path):
    tracks, leaves = exits
    found = sg.calibrate(tracks, goals={"exit": {"place": EXIT.place, "speed": EXIT.speed}})
    leaving = found.classes.goals.index("exit")
    probability = dict(zip([d.vehicle for d in found.drivers], found.classes.goal_probability[:, leaving], strict=True))
    off = [(probability[name] - wants) ** 2 for name, wants in leaves.items()]
    assert np.mean(off) < 0.02  # the share alone gives 0.14
    # nobody is sure of it, so no row has the goal
    assert not found.rows[:, ROW.places["goal_ahead"]].any()
    assert found.to_frame()["exit"].tolist() == list(probability.values())
    of_lane = dict(zip(found.classes.entries, found.classes.goal_share[:, leaving], strict=True))
    assert of_lane["left"] < of_lane["right"]
    document = found.document(1.0)
    assert document["goals"]["left"]["exit"] == pytest.approx(of_lane["left"])
    # the model file says it to the live nodes
    found.save(tmp_path / "goals.yaml")
    goals = read_model(tmp_path / "goals.yaml").goals
    assert goals.goals == (EXIT,)
    assert goals.prior.sum() == pytest.approx(1.0)
    written = yaml.safe_load((tmp_path / "goals.yaml").read_text())
    written["goals"][0]["share"] = 2.0
    (tmp_path / "goals.yaml").write_text(yaml.safe_dump(written))
    with pytest.raises(InputError, match=r"goals: .*share"):
        read_model(tmp_path / "goals.yaml")


@pytest.mark.parametrize("leaves", [True, False])
def test_a_goal_is_told_online_and_a_filter_of_one_goal_is_the_plain_filter(leaves):
    row = ROW.with_effects(defaults(1)[0])
    row[V_STAR], row[KAPPA_V] = 14.0, 0.4
    way = approach(np.random.default_rng(8), leaves)
    goals = np.array([np.zeros(ROW.width), EXIT.row])
    online = GoalFilter(PERIOD_S, Road(), row, goals, np.array([0.7, 0.3]), vehicles=3)
    alone = GoalFilter(PERIOD_S, Road(), row, goals[:1], np.ones(1), vehicles=3)
    for k, position in enumerate(way):
        sample = position, [0, 1, 2], [4.5] * 3, k * PERIOD_S
        if k == len(way) // 2:
            saved = online.saved()
            online.step(*sample)
            online.restore(saved)
        online.step(*sample)
        alone.step(*sample)
        assert online.goal_probability.sum() == pytest.approx(1.0)
    assert (online.goal_probability[1] > 0.9) if leaves else (online.goal_probability[1] < 0.1)
    assert alone.goal_probability == [1.0]


def test_one_class_with_one_goal_is_the_fit_of_one_driver_for_all(short, work):
    """At the maximum, the slopes of all drivers together are 0."""
    data = prepare(short[0], most=None)
    found = find_classes(data, 1, ESTIMATED, work)
    assert found.probability == pytest.approx(np.ones((data.drivers, 1)))
    again = find_classes(data, 1, ESTIMATED, work, goals=goals_of((), ["x"] * data.drivers))
    assert np.array_equal(found.rows, again.rows)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("exit", "give numbers for place"),
        ("exit:speed=8", "give numbers for place"),
        ("exit:place=500,colour=3", "'colour' is not known; the parameters are deceleration, place, speed"),
        ("exit:place=500,place=600", "place is given twice"),
        ("exit:place=500,lane=1,lane=2", "lane is given twice"),
        ("through:place=500", "is no name"),
        ("exit:place=500,deceleration=0", "deceleration is 0; give 0.01 to 10 m/s"),
        ("exit:place=500,speed=900", "speed"),
    ],
)
def test_goals_that_are_none_are_refused(text, says):
    with pytest.raises(InputError, match=says):
        read_goal(text, "--goal")


def test_too_few_drivers_and_a_goal_out_of_reach_are_refused(exits, short):
    few = short[0].select(np.asarray(short[0].run) < 4)
    with pytest.raises(InputError, match="3 drivers, too few to hold some out"):
        sg.calibrate(few, classes="auto")
    with pytest.raises(InputError, match="place 5000 m is out of reach: vehicles are seen from"):
        sg.calibrate(exits[0], goals={"exit": {"place": 5000.0}})
    with pytest.raises(InputError, match="give values by name"):
        sg.calibrate(exits[0], goals=["exit"])


def test_a_lane_on_which_nobody_comes_in_is_refused():
    with pytest.raises(InputError, match="nobody comes in on lane 3; the lanes are 1, 2"):
        goals_of((Goal("exit", 500.0, lane="3"),), ["1", "2", "1"])
