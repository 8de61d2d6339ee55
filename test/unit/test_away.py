"""The benchmark away from home: its own driver model and laws against the package's, and what it calls right."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.away.__main__ import _read, _write
from benchmarks.away.cases import PARTS, Case, cases, recorded
from benchmarks.away.drivers import LAW_MEANS, Sight, drawn, followers, law_action, noises
from benchmarks.away.drivers import mean_action as mean_again
from benchmarks.away.judged import Judged, report
from benchmarks.away.world import History, Setup, drive
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, at_period, defaults, horizon_at
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.laws.registry import LAWS

COUNT = 200


def views(rng):
    gap, speed = rng.uniform(-0.5, 30.0, COUNT), rng.uniform(-0.5, 13.0, COUNT)
    gap[:5] = np.inf
    other = rng.uniform(0.0, 13.0, COUNT)
    zero = np.zeros(COUNT)
    return Sight(0.0, zero, speed, zero, zero, gap, other, zero, gap, other, gap, other)


@pytest.mark.parametrize("period", [0.1, 1.0 / 3.0, 0.5, 1.0])
def test_both_driver_models_agree(period):
    rng = np.random.default_rng(1)
    view, people = views(rng), drawn(COUNT, rng)
    rows = defaults(COUNT)
    rows[:, V_STAR], rows[:, KAPPA_V] = people.desired_speed, people.risk_premium
    scaled, horizon = at_period(rows, period), horizon_at(period)
    package = [
        mean_action(*at, row, ACTIONS, period, horizon)
        for *at, row in zip(view.gap, view.speed, view.leader_speed, scaled, strict=True)
    ]
    assert mean_again(view, people, period) == pytest.approx(np.array(package), abs=1e-9)
    rho, sigma_a, sigma_x, sigma_v = noises(people, period)
    assert scaled[0, [9, 1, 10, 11]] == pytest.approx([rho, sigma_a[0], sigma_x, sigma_v], rel=1e-12)


@pytest.mark.parametrize("name", list(LAW_MEANS))
def test_both_implementations_of_a_law_agree(name):
    rng = np.random.default_rng(2)
    view, people = views(rng), followers(name, COUNT, rng)
    moving = (view.gap > 0.1) & np.isfinite(view.gap) & (view.speed >= 0.0)
    package = [
        LAWS[name].function(*at, p)
        for *at, p in zip(view.gap, view.speed, view.leader_speed, people.values, strict=True)
    ]
    assert law_action(view, people)[moving] == pytest.approx(np.array(package)[moving], abs=1e-9)


def test_the_past_lies_between_samples():
    zero = np.zeros(2)
    seen = [Sight(k / 3.0, *[zero + k] * 11) for k in range(4)]
    moment = History(Setup(), seen)
    assert moment.ago(0.0).gap == pytest.approx([3.0, 3.0])
    assert moment.ago(0.5).gap == pytest.approx([1.5, 1.5])
    assert moment.ago(99.0).gap == pytest.approx([0.0, 0.0])


def test_cases_have_one_name_each_and_every_part_has_some():
    known = [case.name for part in PARTS for case in cases(part) if part != "few"]
    assert len(known) == len(set(known))
    assert len(cases("forms")) >= 12
    assert len(cases("laws")) == 6


def test_two_recordings_of_the_same_drivers():
    case = Case("few", "three", Setup(drivers=6, ring_m=80.0, duration_s=20.0), cases("few")[1].builders, few=2)
    pair = recorded(case, "strong", 3)
    assert pair.first.position_m.shape == pair.second.position_m.shape == (61, 6)
    assert not np.array_equal(pair.first.position_m, pair.second.position_m)
    assert len(pair.who) == 2
    assert np.array_equal(recorded(case, "strong", 3).first.position_m, pair.first.position_m)


def test_what_a_few_drivers_do_the_others_do_not():
    """With the same noise, the drivers behave alike until what the few do reaches them."""
    setup, rng = Setup(drivers=6, ring_m=80.0, duration_s=4.0), np.random.default_rng(5)
    people = drawn(6, rng)
    for case in cases("few"):
        hidden = case.builders[0](2.5, setup, np.random.default_rng(6)).hidden
        one = replace(hidden, who=np.arange(6) == 2)
        alone, nobody = (drive(setup, people, some, np.random.default_rng(7), True) for some in ([one], []))
        same = np.abs(alone[:3] - nobody[:3]).max(axis=0) == 0.0
        assert same[[0, 1, 3, 4, 5]].all(), case.name


def row(**changes):
    base = Judged(
        part="forms",
        name="brake lights",
        strength="strong",
        seed=1,
        right=("second_leader",),
        covariates=("leader_acceleration",),
        law="",
        vehicles=(),
        outcome="not_explained",
        failed=("bias_over_leader_acceleration",),
        laws=(),
        named=("drag",),
        also=(),
        forces=(),
        who=(),
        p_value=0.5,
        oracle=0.0,
        heldout=30.0,
        heldout_se=5.0,
        fresh=20.0,
        fresh_se=5.0,
        errors={"drag.c0": 1.0},
        seconds=1.0,
    )
    return replace(base, **changes)


def test_what_counts_as_right():
    assert row().is_right
    assert not row().is_misleading
    assert not row(outcome="explained").is_right
    assert row(outcome="explained").is_misleading
    assert row(named=("second_leader",), outcome="explained").is_right
    assert row(covariates=("gap",), failed=("left_for_force_along_gap",)).is_right
    assert row(failed=(), named=("discovered_force",), forces=("leader_acceleration",)).is_right
    # "gap" is not "rear_gap"
    assert not row(covariates=("gap",), failed=("bias_over_rear_gap", "spread_of_innovations")).is_right
    assert row(part="laws", law="idm", laws=("fvdm", "idm")).is_right
    assert not row(part="laws", law="idm", laws=("fvdm",)).is_right
    assert not row(part="laws", law="idm", laws=("idm",), outcome="explained").is_right
    assert row(part="conditions", right=(), named=(), outcome="adequate").is_right
    assert not row(part="conditions", right=(), named=(), failed=("mean_speed",)).is_right
    few = row(part="few", vehicles=(1, 2), named=("second_leader",))
    assert not few.is_right
    assert replace(few, who=(1, 2, 5)).is_right


def test_rows_are_kept_and_read_again(tmp_path):
    rows = [row(), row(seed=2, part="conditions", named=())]
    _write(rows, tmp_path / "rows.jsonl")
    assert _read(tmp_path / "rows.jsonl") == rows
    assert json.loads((tmp_path / "rows.jsonl").read_text().splitlines()[0]) == json.loads(json.dumps(asdict(rows[0])))
    text = report(rows)
    assert "| forms | 1 | 1 of 1 |" in text
    assert "within two standard errors: 1 of 1" in text
