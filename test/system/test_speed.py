"""How often the filter runs, and that `make bench` measures the speed: how fast the machine is does not matter here."""

import json
import re
import sys

import pytest

from benchmarks.speed.__main__ import PARTS, main
from benchmarks.speed.timing import counted, jam
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.trajectories.dense import tracks_of

pytestmark = pytest.mark.system
#: Passes of the causal filter over one driver, for 6 drivers of 100 s.
KNOWN_PASSES = {"calibration": 362, "diagnosis": 4660}
#: A search that takes half as many more passes exceeds this factor.
SLOWER = 1.4


def test_calibration_and_diagnosis_filter_no_more_often_than_they_did():
    t = jam(6, 100.0)
    passes = {
        "calibration": counted(lambda: each_driver(t, Settings()))[0],
        "diagnosis": counted(lambda: diagnose(tracks_of(t), most=1, workers=2))[0],
    }
    for name, known in KNOWN_PASSES.items():
        assert 0 < passes[name] < SLOWER * known, passes


def test_a_part_is_printed_as_text_as_one_document_and_as_a_page(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(sys, "argv", ["speed", "--part", "throughput"])
    main()
    assert re.fullmatch(
        r"throughput\n +simulation, .* µs\n +one message .* µs   at most 6.7\n", capsys.readouterr().out
    )
    monkeypatch.setattr(sys, "argv", ["speed", "--part", "throughput", "--json", "--write", str(tmp_path / "speed.md")])
    main()
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert [(one["part"], one["name"], one["at_most"]) for one in figures] == [
        ("throughput", "simulation_us", None),
        ("throughput", "bag_message_us", 6.7),
    ]
    page = (tmp_path / "speed.md").read_text()
    assert page.startswith("# Speed\n")
    assert page.count("\n| ") == 1 + len(figures)


def test_a_part_whose_library_is_not_installed_is_left_out(monkeypatch, capsys):
    monkeypatch.setitem(PARTS, "peers", "no_such_library.peers")
    monkeypatch.setattr(sys, "argv", ["speed", "--part", "peers", "--json"])
    main()
    out, err = capsys.readouterr()
    assert json.loads(out)["figures"] == []
    assert err == "left out: peers: no_such_library is not installed; see requirements-dev.txt\n"
