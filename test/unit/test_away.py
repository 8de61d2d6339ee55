"""The benchmark away from home: its own driver model and laws against the package's, and what it calls right."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.away.drivers import LAW_MEANS, Sight, drawn, followers, law_action, noises
from benchmarks.away.drivers import mean_action as mean_again
from benchmarks.away.judged import Judged
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


@pytest.mark.parametrize("period", [0.1, 1.0])
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
