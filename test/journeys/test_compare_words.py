"""A user compares models, and reads one sentence and about six rows; nobody who leads is counted."""

import json
import re
from functools import partial

import numpy as np
import pytest

import sugiyama_ros as sg

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def run(folder, forks):
    return partial(forks.run_text, folder)


def rows(text):
    """Names of the models in the tables."""
    return [line.split("│")[1].strip() for line in text.splitlines() if line.startswith("│")]


def test_a_comparison_says_who_is_best_and_shows_six_rows(run, folder):
    run("sugiyama simulate --vehicles 4 --ring 45 --duration 40 --seed 1 -o ring.csv")
    run("sugiyama simulate --vehicles 4 --ring 45 --duration 40 --seed 2 -o other.csv")
    diagnosed = run("sugiyama diagnose ring.csv --ring 45 --simulations 1 --add drag -o model.yaml")
    assert diagnosed.code == 0, diagnosed.err
    assert diagnosed.err.startswith("diagnosing 4 vehicles in 1 recording")
    (elsewhere,) = re.findall("(sugiyama compare OTHER .*)", diagnosed.out)
    said = run("sugiyama compare ring.csv --ring 45 --model model.yaml --seed 1")
    assert said.code == 0, said.err
    own = "file: drag was fitted to these samples, so it does not count here. "
    first = said.out.splitlines()[0].removeprefix(own)
    assert said.out.startswith(own)
    none = r"No other model forecasts unseen data better than the base model; .* is \d+ ± \d+ nats behind\."
    assert re.fullmatch(none, first) or re.match(
        r"[\w, ]+ forecasts unseen data best, \d+ ± \d+ nats better than the base model", first
    )
    assert "in sample" in said.out
    shown = rows(said.out)
    assert len(set(shown)) == 6
    assert {"base", "file: drag"} <= set(shown)
    assert "model.yaml was fitted to this recording, so its errors are in sample" in said.out
    # the file's own effects, fitted without what they predict; and everything: both can be pasted
    anew, everything = said.steps
    assert "--model" not in anew
    assert "--ring 45" in anew
    assert "--seed 1" in anew
    whole = run(everything)
    assert whole.code == 0, whole.err
    assert len(set(rows(whole.out))) > 12
    assert "floor" not in whole.out  # a word of the report, where it is another model
    assert "The whole road: recorded and simulated" in whole.out
    fresh = run(elsewhere.replace("OTHER", "other.csv"))
    assert fresh.code == 0, fresh.err
    assert fresh.err.startswith("comparing models on 4 vehicles in 1 recording")
    assert "in sample" not in fresh.out
    assert "model.yaml: what it says of the road and of all drivers is taken as it is; sigma_nu," in fresh.out
    document = json.loads(run(elsewhere.replace("OTHER", "other.csv") + " --json").out)
    assert [one["name"] for one in document["models"] if one["kind"] == "given"] == ["file: drag"]
    assert document["headline"] == fresh.out.splitlines()[0]
    assert document["given"]["fitted"][-2:] == ["v_star", "kappa_v"]
    # the drivers of the file drive where and as often as they did
    again = run("sugiyama simulate --model model.yaml --duration 10 -o again.csv --json")
    assert json.loads(again.out)["vehicles"] == 4
    assert run("sugiyama info again.csv --ring 45").code == 0


def test_one_step_ahead_counts_followers_as_gains_do(run, folder):
    made = run("sugiyama simulate --vehicles 4 --ring 0 --duration 40 --seed 1 -o open.csv")
    assert made.code == 0, made.err
    base = sg.compare(sg.read(folder / "open.csv"))
    forecasts = base.models[0].forecasts
    known = np.isfinite(forecasts.one_step)
    assert known.any(axis=1).sum() == 3
    expected = np.sqrt(np.mean(np.square(forecasts.innovation_m[known])))
    assert base.records()[0]["one_step_rmse_m"] == pytest.approx(expected)
    assert "mean of 3" in run("sugiyama run open.csv -o open.mcap").out
