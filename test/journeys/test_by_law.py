"""A user whose drivers follow another law than the paper's: calibrates them, follows them live, and goes on."""

import json
from functools import partial

import numpy as np
import pytest
import yaml

from sugiyama_ros.laws.registry import LAWS

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
#: What the simulated drivers have: the usual values of the law.
TRUTH = {f"idm.{p.name}": p.default for p in LAWS["idm"].parameters}


@pytest.fixture(scope="module")
def run(tmp_path_factory, forks):
    folder = tmp_path_factory.mktemp("by_law")
    ask = partial(forks.run_text, folder)
    made = ask("sugiyama simulate --law idm --vehicles 8 --ring 135 --duration 200 --seed 11 -o ring.csv")
    assert made.code == 0, made.err
    return folder, ask


def test_the_parameters_of_the_law_are_calibrated(run):
    folder, ask = run
    said = ask("sugiyama calibrate ring.csv --ring 135 --law idm -o model.yaml --json")
    assert said.code == 0, said.err
    drivers = json.loads(said.out)["drivers"]
    for name in ("idm.v0", "idm.T"):
        off = [(one[name] - TRUTH[name]) / one["std"][name] for one in drivers]
        assert abs(np.mean(off)) < 3.0, name
    assert list(yaml.safe_load((folder / "model.yaml").read_text())["drivers"][0]["law"]) == ["idm"]


def test_they_are_learnt_live_and_shown(run):
    _, ask = run
    said = ask("sugiyama run ring.csv --ring 135 --law idm -o run.mcap --json")
    assert said.code == 0, said.err
    drivers = json.loads(said.out)["drivers"]
    assert all("idm.T" in one["identified"] for one in drivers)
    assert np.median([one["law"]["idm.T"] for one in drivers]) == pytest.approx(TRUTH["idm.T"], rel=0.15)
    assert np.mean([one["nis_mean"] for one in drivers]) == pytest.approx(1.0, abs=0.2)


def test_a_model_file_says_the_law_itself(run):
    _, ask = run
    refused = ask("sugiyama run ring.csv --ring 135 --law idm --model model.yaml -o no.mcap")
    assert refused.code == 2
    assert "leave out --law or --model" in refused.err
    refused = ask("sugiyama live --law nosuch")
    assert refused.code == 2
    assert "law 'nosuch': not known" in refused.err
    refused = ask("sugiyama run ring.csv --ring 135 -o new.csv")
    assert refused.code == 2
    assert "new.csv: cannot be written as .csv; give a name that ends in .mcap" in refused.err
    said = ask("sugiyama run ring.csv --ring 135 --model model.yaml -o again.mcap")
    assert said.code == 0, said.err
    assert "idm.T [s]" in said.out
    assert "v* [m/s]" not in said.out
