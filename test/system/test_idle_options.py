"""Whatever can be asked of a simulation changes what it writes, or is refused: no option is without effect."""

import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros import cli
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.cli.simulate import _SimulateOptions
from sugiyama_ros.diagnosis.candidates import check_names
from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.effects.effect import CURVES, RING, SIGNALS, YIELDS, Extent
from sugiyama_ros.effects.needs import check_effect
from sugiyama_ros.effects.registry import EFFECTS, ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import drive_by
from sugiyama_ros.simulation.experiment import Experiment, carry_out, changed
from sugiyama_ros.simulation.lanes import alike_lanes
from sugiyama_ros.simulation.scenes import SCENES, road_of, simulate_scene
from sugiyama_ros.studies.registry import STUDIES

pytestmark = pytest.mark.system
ROADS = {"ring": (RING,), "open": (), "lanes": ()}
# Values with which an effect shows in a short run, where those of its search or its benchmark do not.
STRONG = {
    "second_leader_utility": {"weight": 1.0, "share": 0.5},
    "curve_speed": {"lateral": 0.3},
    "limited_power": {"power": 1.0},
    "limited_braking": {"limit": 0.5},
    "external_push": {"strength": 2.0, "time": 20.0, "duration": 10.0},
    "discovered_force": {"covariate": 1.0, "first": 0.0, "last": 20.0, "force_1": 0.5, "force_2": 0.5},
}
PLACES = [("ring", "adaptive_seek"), ("open", "adaptive_seek"), ("lanes", "adaptive_seek"), ("ring", "idm")]
PLACES += [(scene, "adaptive_seek") for scene in SCENES] + [("roundabout", "idm")]


def drivers(law, count=14):
    rows = ROW.with_effects(defaults(count))
    return rows if law == "adaptive_seek" else np.array([drive_by(row, law) for row in rows])


def simulated(place, rows):
    if place in SCENES:
        return simulate_scene(place, rows, 1, duration_s=60.0, period_s=1 / 3).measured.s_m
    experiment = Experiment(120.0 if place == "ring" else 0.0, 30.0, seed=1)
    if place == "lanes":
        return alike_lanes(experiment, rows, 2, (-np.inf, np.inf)).s_m
    return carry_out(experiment, rows).dense.position_m


def values_of(effect):
    """Values with which an effect acts: strong ones, of its benchmark, or of the start of its search."""
    everything = Extent(0.0, 30.0, 120.0, 0.0, 120.0, has_lines=True, has_curves=True)
    known = [STRONG[effect.name]] if effect.name in STRONG else [*effect.benchmark, *effect.starts(everything)]
    values = dict(known[0]) if known else {effect.parameters[0].name: 0.3 * effect.parameters[0].upper}
    usual = {"place": 40.0, "time": 10.0}
    return {p.name: usual[p.axis] for p in effect.parameters if p.axis in usual} | values


@pytest.mark.parametrize(("place", "law"), PLACES)
def test_every_effect_acts_or_is_refused(place, law):
    rows, road = drivers(law), ROADS[place] if place in ROADS else road_of(place)
    without, idle, refused = simulated(place, rows), [], []
    for name, effect in EFFECTS.items():
        with_it = switch_on(rows, name, values_of(effect))
        try:
            changed(rows, {}, {name: values_of(effect)}, road)
        except InputError as error:
            refused.append(str(error).startswith(f"effect {name}: ") and "; leave " in str(error))
            if place != "ring":
                continue
        if np.array_equal(simulated(place, with_it), without, equal_nan=True):
            idle.append(name)
    assert all(refused)
    # on the ring, what is refused has been tried, too
    assert len(idle) == (len(refused) if place == "ring" else 0), idle
    assert len(refused) < 0.6 * len(EFFECTS)


def test_what_an_effect_needs_is_what_its_search_needs():
    """A search begins only on roads on which the effect acts."""
    plain = Extent(0.0, 30.0, 0.0, 0.0, 120.0)
    for effect in EFFECTS.values():
        if not effect.is_searched:
            continue
        for need, extent in {
            RING: plain._replace(circumference_m=120.0),
            YIELDS: plain._replace(has_lines=True),
            SIGNALS: plain._replace(has_lines=True),
            CURVES: plain._replace(has_curves=True),
        }.items():
            assert bool(effect.starts(extent)) or need not in effect.needs
        assert bool(effect.starts(plain)) == (not effect.needs)


# For each option of the command, a value; or why it has none.
OPTIONS: Mapping[str, tuple[str, ...] | str] = {
    "output": "the file itself",
    "model": "is read by other tests",
    "overwrite": "writes over the same file",
    "as_json": "is how the result is shown",
    "law": "is one of the columns",
    "effect": "has a test of its own",
    "vehicles": ("--vehicles", "9"),
    "ring": ("--ring", "150"),
    "lanes": ("--lanes", "2"),
    "scene": ("--scene", "merge"),
    "view": ("--view", "-20,20"),
    "duration": ("--duration", "10"),
    "period": ("--period", "0.25"),
    "spread": ("--spread", "0.2"),
    "start": ("--start", "equal"),
    "controlled": ("--controlled", "0", "--controller", "constant_speed:target=3"),
    "controller": ("--controller", "constant_speed:target=3"),
    "parameter": ("--set", "v_star=7"),
    "seed": ("--seed", "5"),
}
SETTINGS = {
    "ring": (),
    "open": ("--ring", "0"),
    "lanes": ("--lanes", "1"),
    "roundabout": ("--scene", "roundabout"),
    "signals": ("--scene", "signals"),
}


def test_all_options_have_a_value_here():
    assert set(OPTIONS) == set(_SimulateOptions.__dataclass_fields__)


@pytest.mark.parametrize("law", ["adaptive_seek", "idm"])
@pytest.mark.parametrize("setting", SETTINGS)
def test_every_option_acts_or_is_refused(setting, law, monkeypatch, capfd, tmp_path):
    def written(*options):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.csv"
        plain = ("--vehicles", "8", "--duration", "40", *SETTINGS[setting], "--law", law)
        monkeypatch.setattr(sys, "argv", ["sugiyama", "simulate", "-o", str(path), *plain, *options])
        with pytest.raises(SystemExit) as end:
            cli.main()
        code, err = end.value.code or 0, capfd.readouterr().err
        assert code in (0, 2)
        if code:
            assert err.startswith("error: ")
            assert len(err.splitlines()) == 1
        return path.read_bytes() if code == 0 else b""

    without, idle = written(), []
    assert without
    parameters = [("--set", f"{name}={1.3 * value:g}") for name, value in zip(NAMES, defaults(1)[0], strict=True)]
    named = [value for value in OPTIONS.values() if isinstance(value, tuple)]
    for options in [*named, *(parameters if setting in ("ring", "roundabout") else ())]:
        if written(*options) == without:
            idle.append(" ".join(options))
    assert not idle


def test_effects_that_drivers_have_already_are_checked_too():
    """Drivers of a model file are those of --effect: what they have may need another road."""
    rows = switch_on(drivers("adaptive_seek"), "curve_speed", STRONG["curve_speed"])
    with pytest.raises(InputError, match=r"^effect curve_speed: does nothing on a road without a curve; leave it out"):
        changed(rows, {}, {}, ROADS["ring"])
    assert np.array_equal(changed(rows, {}, {}, road_of("roundabout")), rows)


@pytest.mark.parametrize("name", ["harshness", "slow_patch"])
def test_diagnose_adds_nothing_that_a_law_does_not_have(name):
    with pytest.raises(InputError, match=rf"^effect {name}: acts on the preferences of adaptive_seek, and idm has"):
        check_names([name], "idm")
    check_names([name], "adaptive_seek")
    check_names(["drag", "discovered_force:speed"], "idm")


def test_the_cure_works():
    rows = drivers("idm")
    with pytest.raises(InputError, match=r"^effect slow_patch: acts on the preferences of adaptive_seek, and idm has"):
        check_effect("slow_patch", rows, ROADS["ring"])
    check_effect("slow_patch", drivers("adaptive_seek"), ROADS["ring"])
    check_effect("drag", rows, ROADS["ring"])
    with pytest.raises(InputError, match=r"^effect late_start: does nothing on a road without a signal; leave it out"):
        check_effect("late_start", rows, road_of("roundabout"))
    check_effect("late_start", rows, road_of("signals"))


def test_calibrate_refuses_what_a_law_does_not_have():
    asked = Settings(estimated=(), law="idm", effects=("slow_patch",))
    with pytest.raises(InputError, match=r"^--effects: slow_patch acts on the preferences of adaptive_seek, and idm"):
        asked.check("--{}".format)
    replace(asked, effects=("drag",)).check("--{}".format)
    replace(asked, law="adaptive_seek").check("--{}".format)


def test_drivers_who_are_pooled_cannot_be_calibrated_alone():
    """With a law or effects, drivers are draws from one population, whatever else is asked."""
    alone = Settings(is_regularised=False)
    alone.check("--{}".format)
    for other in (replace(alone, estimated=(), law="idm"), replace(alone, effects=("drag",))):
        with pytest.raises(InputError, match=r"^--regularise: cannot be off with --(law|effects), .*leave out one of"):
            other.check("--{}".format)
        replace(other, is_regularised=None).check("--{}".format)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["study", "spectrum", "--runs", "2"], "study spectrum: does not use --runs"),
        (["study", "spectrum", "--ring", "-5"], "--ring: is for measured drivers"),
        (["study", "recovery", "ring.mcap"], "study recovery: does not use FILE"),
        (["study", "measured", "ring.mcap", "--seed", "3"], "study measured: does not use --seed"),
        (["study", "--seed", "3"], "study: --seed, and no name"),
        (["study", "--output", "x.png"], "study: --output, and no name"),
        (["demo", "--data", "ring.mcap", "--hidden", "drag"], "--hidden: is for simulated drivers"),
        (["demo", "--ring", "40"], "--ring: is for measured drivers"),
    ],
)
def test_commands_refuse_what_they_do_not_use(words, why, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["sugiyama", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    out, err = capfd.readouterr()
    assert (end.value.code, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith(f"error: {why}")
    assert "leave" in err or "give" in err
    assert not list(tmp_path.iterdir())


def test_studies_use_what_they_say():
    for one in STUDIES.values():
        one.check(one.takes)
        assert set(one.takes) <= {"source", "runs", "seed"}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--vehicles 1 --effect second_leader:weight=0.5", "effect second_leader: changes nothing that anybody"),
        ("--vehicles 1 --ring 0 --set kappa_d=0.5", "parameter kappa_d: changes nothing that anybody"),
        ("--effect drag:c0=0", "effect drag: changes nothing that anybody"),
        ("--effect drag:c0=0.3 --effect external_push:strength=1,time=99,duration=1", "effect external_push: changes"),
        ("--ring 0 --effect slow_patch:reduction=0.3,centre=9000,width=10", "effect slow_patch: changes nothing"),
        ("--lanes 2 --effect slow_patch:reduction=0.3,centre=9000,width=10", "effect slow_patch: changes nothing"),
        ("--scene merge --effect slow_patch:reduction=0.3,centre=9000,width=10", "effect slow_patch: changes nothing"),
        ("CONTROLLED --set v_star=8", "parameter v_star: changes nothing"),
        ("CONTROLLED --effect drag:c0=0.3", "effect drag: changes nothing"),
        ("CONTROLLED --law idm", "law: is for drivers, and a controller drives every vehicle; leave out the law, or"),
        ("CONTROLLED --spread 0.1", "spread: is for drivers, and a controller drives every vehicle; leave out the s"),
        ("CONTROLLED --set sigma_nu=0.3", ""),
        ("--effect slow_patch:reduction=0.3,centre=20,width=10 --set v_star=11 --spread 0.1", ""),
        ("--scene merge --view 0,100", "--view: is for lanes; give --lanes in place of --scene, or leave it out"),
        ("--view 0,100", "--view: is for lanes; add --lanes, or leave it out"),
    ],
)
def test_simulate_refuses_what_changes_nothing(words, why, monkeypatch, capfd, tmp_path):
    every = "--vehicles 3 --controlled 0,1,2 --controller constant_speed:target=3"
    given = words.replace("CONTROLLED", every).split()
    vehicles = () if "--vehicles" in given else ("--vehicles", "3")
    output = tmp_path / "out.csv"
    argv = ["sugiyama", "simulate", "-o", str(output), "--duration", "10", *vehicles, *given]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit) as end:
        cli.main()
    err = capfd.readouterr().err
    assert (end.value.code or 0) == (2 if why else 0), err
    assert output.exists() is not bool(why)
    if why:
        assert err.startswith(f"error: {why}")
        assert len(err.splitlines()) == 1


def test_simulate_in_python_refuses_what_changes_nothing():
    few = {"vehicles": 3, "ring_m": 60.0, "duration_s": 5.0}
    with pytest.raises(InputError, match=r"^effect external_push: changes nothing that anybody here does"):
        sg.simulate(**few, effects={"external_push": {"strength": 1.0, "time": 60.0, "duration": 1.0}})
    with pytest.raises(InputError, match=r"^law: is for drivers"):
        sg.simulate(**few, law="idm", controlled=[0, 1, 2], controller="constant_speed")
    sg.simulate(**few, law="idm", controlled=[0, 1], controller="constant_speed")
