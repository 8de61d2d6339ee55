"""Studies of few drivers and few runs: an answer, or one line with the cure; never a warning."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from journeys.forks import Forks

from sugiyama_ros.errors import InputError
from sugiyama_ros.studies import rings
from sugiyama_ros.studies.rings import jams

pytestmark = pytest.mark.system


def test_types_of_few_drivers(tmp_path: Path, forks: Forks) -> None:
    """There are fewer clusters than drivers, and two drivers have no types."""
    tell = partial(forks.run_text, tmp_path)
    for made in ("--vehicles 6 --ring 70 -o six.csv", "--vehicles 2 --ring 40 -o two.csv"):
        assert tell(f"sugiyama simulate --duration 40 {made}").code == 0
    done = tell("sugiyama study types six.csv --ring 70 --json")
    assert (done.code, done.err) == (0, "")
    rows = json.loads(done.out)["rows"]
    assert [row["clusters"] for row in rows] == list(range(2, rows[0]["drivers"]))
    assert all(np.isfinite(row["agreement of draws"]) for row in rows)
    done = tell("sugiyama study types two.csv --ring 40")
    assert done.code == 2
    assert done.err.startswith("error: study types: v_star is identified for ")
    assert len(done.err.splitlines()) == 1


def test_where_all_runs_collide_the_cure_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    class Crash:
        collisions = (1,)

    monkeypatch.setattr(rings, "run", lambda ring: Crash())
    with pytest.raises(InputError, match=r"cars collide in all simulated runs \(2\); give more --runs, or another"):
        list(jams({}, 2, 0, 10.0))
