"""What is compiled after an installation is all that the commands need, whatever the data."""

import sys
from importlib.util import cache_from_source
from pathlib import Path

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros import jit, progress
from sugiyama_ros.compile import compile_all
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.online import OnlineFilter


def compiled() -> dict[str, int]:
    """How many versions of each function of the package are compiled."""
    modules = [module for name, module in sys.modules.items() if name.startswith("sugiyama_ros.")]
    functions = {id(one): one for module in modules for one in vars(module).values() if isinstance(one, jit.Kernel)}
    return {f"{f.py_func.__module__}.{f.py_func.__name__}": len(f.entry.signatures) for f in functions.values()}


def test_after_compiling_nothing_is_left_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    compile_all(told.append)
    before = compiled()
    assert len(told) == 8
    # Python writes no bytecode by itself where PYTHONDONTWRITEBYTECODE is set
    assert all(Path(cache_from_source(str(one))).exists() for one in Path(sg.__file__).parent.glob("cli/*.py"))
    # for one chain and for many, in double and in single precision
    assert before["sugiyama_ros.filters.causal.run"] == 1
    assert before["sugiyama_ros.filters.paper.run"] == 1

    compiled_later: set[str] = set()
    monkeypatch.setattr(progress, "on_compiling", lambda what, done, total: compiled_later.add(what))
    effects = {"outlier_noise": {"share": 0.02, "factor": 3.0}, "drag": {"c0": 0.1}}
    recording = sg.simulate(4, ring_m=0.0, duration_s=40.0, effects=effects, seed=2).measured
    sg.calibrate(recording, "paper", profile=True)
    sg.calibrate(recording)
    sg.calibrate(recording, effects=["drag"])
    sg.compare(recording)
    sg.diagnose(recording)
    row = switch_on(ROW.with_effects(defaults()), "sensor_eccentricity", {"cosine": 0.5, "sine": 0.3})
    road = recording.dense()
    for parameters in (None, row):
        online = OnlineFilter(road.period_s, road.road, parameters)
        for position in road.position_m[:, 1:].tolist():
            estimate = online.step(position, [1, 2, 3], [4.3, 4.3, 4.3])
        assert np.isfinite(estimate.speed)
    assert compiled() == before
    assert compiled_later == set()
