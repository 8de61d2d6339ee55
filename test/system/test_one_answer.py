"""One recording gives one answer: terminal, document, model file, report and critic agree, or say why not."""

import csv
import json
import subprocess
import sys
from html import escape
from pathlib import Path

import numpy as np
import pytest
import yaml

from sugiyama_ros.page.names import addition
from sugiyama_ros.page.recording import preferred, read_recording
from sugiyama_ros.page.words import WHY, badge, beside_the_verdict, headline, may_be_chance, sentences

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(3600)]
SUGIYAMA = str(Path(sys.executable).with_name("sugiyama"))
DATA = Path(__file__).parents[2].parent / "shared" / "data"
CASE1, HEFEI = DATA / "sugiyama2008_mstf" / "case1.data", DATA / "hefei_platoon"
DOCS = Path(__file__).parents[2] / "docs"


def sugiyama(*arguments):
    done = subprocess.run([SUGIYAMA, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def platoon(output):
    """Write the first three cars of the platoon of Hefei, at 0.3 s."""
    pairs = [np.loadtxt(HEFEI / f"dataVehicle{number}.txt")[:, :3] for number in (101, 102)]
    times = np.intersect1d(*(pair[:, 0] for pair in pairs))[::3]
    first, second = (pair[np.isin(pair[:, 0], times)] for pair in pairs)
    with output.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["time_s", "vehicle", "position_m", "length_m"])
        for k, time in enumerate(0.1 * (times - times[0])):
            for number, place in enumerate((first[k, 1], first[k, 2], second[k, 2])):
                rows.writerow([f"{time:.1f}", 100 + number, place, 5.0])


def recording(name, folder):
    """Arguments that name a recording."""
    if name == "case 1":
        if not CASE1.exists():
            pytest.skip("needs the measured experiment, which may not be passed on")
        return [CASE1, "--ring", 230]
    if name == "platoon":
        if not HEFEI.exists():
            pytest.skip("needs the platoon of Hefei, which may not be passed on")
        platoon(folder / "platoon.csv")
        return [folder / "platoon.csv"]
    hidden = ["--effect", "slow_patch:reduction=0.3,centre=117,width=80"] if name == "hidden" else []
    sugiyama("simulate", "-o", folder / "sim.mcap", "--seed", 41, "--spread", 0.05, *hidden)
    return [folder / "sim.mcap"]


@pytest.mark.parametrize("name", ["hidden", "nothing hidden", "case 1", "platoon"])
def test_terminal_document_model_report_and_critic_agree_or_say_why_not(name, tmp_path):
    source = recording(name, tmp_path)
    told = sugiyama("diagnose", *source, "--add", "auto", "-o", tmp_path / "model.yaml", "--json")
    (tmp_path / "d.json").write_text(told)
    sugiyama("run", *source, "--critic", "-o", tmp_path / "run.mcap")
    sugiyama("report", tmp_path / "run.mcap", "--diagnosis", tmp_path / "d.json", "-o", tmp_path / "run.html")
    document = json.loads(told)
    agree(document, tmp_path / "run.mcap", tmp_path / "run.html")
    effects = [one["name"] for one in document["verdict"]["effects"]]
    in_model = yaml.safe_load((tmp_path / "model.yaml").read_text())
    for one in document["verdict"]["effects"]:
        if one["kind"] == "effect":
            assert one["form"] in json.dumps(in_model)
    if name == "hidden":
        assert effects == ["slow_patch"]
    if name == "nothing hidden":
        assert effects == []
    if name == "case 1":
        rows = [line for line in (DOCS / "case1.md").read_text().splitlines() if line.startswith("| + ")]
        assert rows[0].startswith(f"| + {effects[0]} ")


def agree(document, bag, page):
    """Assert that the sentences of the terminal, the document, the report and the critic tell the same."""
    verdict, text = document["verdict"], page.read_text()
    card = text.split("<nav>")[0]
    outcome, effects = verdict["outcome"], verdict["effects"]
    starts = {"adequate": "The model is adequate", "explained": "What was missing is", "not_explained": "Not explained"}
    assert verdict["told"][0].startswith(starts[outcome])
    assert verdict["told"] == sentences(document)
    assert escape(badge(document)[1]) in card
    said = headline(document).removeprefix(f"{badge(document)[1]}: ")
    assert escape(said[1:]) in card
    for one in effects:
        assert sum(line.startswith(f"{addition(document, one)}: ") for line in verdict["told"]) == 1
        assert escape(addition(document, one)) in text
    for when in ("before", "after"):
        flagged = f"{len(document['where'][when]['flagged'])} of {len(document['where'][when]['bins'])}"
        assert flagged in card
        if when == "before" or effects:
            assert any(f"is biased in {flagged} bins" in line for line in verdict["told"])
    held = sum(not one["failed"] for one in document["checks"])
    assert f"{held} of {len(document['checks'])}" in card
    r = read_recording(bag)
    best, lead = preferred(r.weights)
    said = beside_the_verdict(document, best, r.added, lead)
    assert escape(said) in text
    finds_nothing = best == "base" or may_be_chance(best, lead)
    agrees = finds_nothing if not effects else not finds_nothing and best in {one["name"] for one in effects}
    assert ("The verdict above says the same." in said) == agrees
    assert agrees or "cannot tell it apart" in said or WHY in said
