"""The main job as a process of its own, on the measured experiment if it is there; and what a kill leaves."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.formats.mcap_reader import Bag

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
SUGIYAMA = [sys.executable, "-m", "sugiyama_ros.cli"]
CASE1 = Path(__file__).parents[2].parent / "shared/data/sugiyama2008_mstf/case1.data"
measured = pytest.mark.skipif(not CASE1.exists(), reason="needs the measured experiment, which may not be passed on")


def sugiyama(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*SUGIYAMA, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The measured experiment, run at full speed in one process."""
    output = tmp_path_factory.mktemp("case1") / "out.mcap"
    return output, json.loads(sugiyama("run", CASE1, "--rate", "max", "-o", output, "--json").stdout)


@measured
def test_nothing_of_the_measured_experiment_is_lost(recorded):
    _, result = recorded
    assert (result["steps"], result["vehicles"], result["messages_lost"]) == (751, 22, 0)
    assert result["messages_published"] == result["messages_recorded"]
    # the value depends on the machine and its load: 120 on 4 idle cores
    assert result["real_time_factor"] > 0
    assert [d["vehicle"] for d in result["drivers"]] == list(range(22))


@measured
def test_what_is_learnt_online_predicts_the_measured_experiment_nearly_as_well_as_the_batch_fit(recorded):
    """The online figure is 0.4085 nats per sample. The batch fit reaches 0.4127 on the samples it was fitted to."""
    output, _ = recorded
    with Bag(output) as bag:
        scored = [
            m.message.log_likelihood
            for m in bag.messages({f"/vehicle_{v:02}/innovation" for v in range(22)})
            if m.message.scored
        ]
    assert np.mean(scored) == pytest.approx(0.4085, abs=0.0005)
    assert np.mean(scored) > 0.98 * 0.4127
