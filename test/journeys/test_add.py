"""A user diagnoses a CSV of a ring, adds what they know, and sees the page: one diagnosis is enough."""

import json
import re
from functools import partial

import numpy as np
import pytest
import yaml

import sugiyama_ros as sg
from journeys.terminal import follow
from sugiyama_ros.errors import InputError

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
#: What is added although nothing of it is in the data, one of each kind: an effect, a group of constants of each
#: driver, a force without a name. Before them stands a form of what is in the data.
ASKED = "clock_offset,drag,rationality,discovered_force:time_gap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("add")


@pytest.fixture(scope="module")
def run(folder, forks):
    return partial(forks.run_text, folder)


@pytest.fixture(scope="module")
def added(run):
    """What a user sees who adds effects by name to a CSV of a ring, whose drivers hold a gap that is off."""
    hidden = "--effect gap_offset:offset=1.0"
    made = run(f"sugiyama simulate --vehicles 5 --ring 56 --duration 50 --seed 3 {hidden} -o ring.csv")
    assert made.code == 0, made.err
    said = run(
        f"sugiyama diagnose ring.csv --ring 56 --simulations 1 --seed 4 --add {ASKED} -o model.yaml --save found.json"
    )
    assert said.code == 0, said.err
    return said


def test_what_is_asked_for_is_added_and_the_data_say_what_they_think_of_it(added, folder):
    document = json.loads((folder / "found.json").read_text())
    effects = {one["name"] if one["covariate"] else one["form"]: one for one in document["verdict"]["effects"]}
    assert [*effects] == [name.partition(":")[0] for name in ASKED.split(",")]
    assert document["verdict"]["asked"] == ASKED.split(",")
    for form, one in effects.items():
        assert np.isfinite([one["heldout_gain_nats"], one["heldout_gain_se"], one["p_value"]]).all()
        typed = f"{form}:{one['covariate']}" if one["covariate"] else form
        start = "drag: " if form == "drag" else rf"[^:(]*\({typed}\): "
        (line,) = (line for line in added.out.splitlines() if re.match(start, line))
        assert f"On unseen data {round(one['heldout_gain_nats'])} ± {round(one['heldout_gain_se'])} nats" in line
    assert effects["discovered_force"]["covariate"] == "time_gap"
    assert not effects["rationality"]["is_supported"]
    lines = [line.strip() for line in added.out.splitlines()]
    said = [line for line in lines if line.startswith("You asked for it; the data do not ask for it: ")]
    assert len(said) == sum(not one["is_supported"] for one in effects.values())
    assert lines.count("The data ask for it.") == len(effects) - len(said)
    # the equation has a bracket for each addition
    (equation,) = [line for line in lines if line.startswith("The model, with what is new in brackets: a = abar(")]
    assert equation.count("[") == len(effects)
    assert lines[0].startswith("What was missing is explained") == any(
        one["is_supported"] and one["kind"] in ("effect", "measurement") for one in effects.values()
    ) or lines[0].startswith("Not explained")
    model = yaml.safe_load((folder / "model.yaml").read_text())
    # the file has what changes the model: nothing of the force was found, and constants are parameters of the driver
    kept = {form for form, one in effects.items() if one["heldout_gain_nats"] and one["kind"] != "constants"}
    assert "clock_offset" in kept
    assert set(model["effects"]) == kept


def test_the_next_steps_work_as_they_are_pasted(added, run, folder):
    (other,) = re.findall(r"sugiyama compare OTHER .*--ring 56 --seed 4", added.out)
    assert run(other.replace("OTHER", "ring.csv")).code == 0
    steps = dict(follow(run, added, set()))
    wrong = [f"{step}\n{answer.err}" for step, answer in steps.items() if answer.code != 0]
    assert not wrong, "\n".join(wrong)
    # the bag is called after the data, and the estimators start from the model that was written
    assert "sugiyama run ring.csv --ring 56 --model model.yaml -o ring.mcap" in steps
    # the run also prints how to see its page without a diagnosis
    assert run("sugiyama report ring.mcap --diagnosis found.json -o asked.html").code == 0
    page = (folder / "asked.html").read_text()
    own = "sugiyama run ring.csv --ring 56 -o ring.mcap --model model.yaml"
    assert f" &amp;&amp; {own} &amp;&amp; sugiyama report ring.mcap --diagnosis found.json" in page
    assert "ther effects were not fitted" in page
    assert "time gap" in page


def test_a_diagnosis_of_another_recording_is_refused_with_the_run_that_it_needs(added, run, folder):
    for command in (
        "sugiyama simulate --vehicles 2 --ring 40 --duration 5 --seed 1 -o other.csv",
        "sugiyama run other.csv --ring 40 -o other.mcap",
    ):
        assert run(command).code == 0
    said = run("sugiyama report other.mcap --diagnosis found.json")
    assert said.code == 2
    (line,) = said.err.splitlines()
    assert "is a diagnosis of ring.csv, but other.mcap is a run of other.csv" in line
    assert said.steps == ["sugiyama run ring.csv --ring 56 -o ring_run.mcap --model model.yaml"]
    assert not (folder / "other.html").exists()
    # a document of before, which does not say what it is of
    document = json.loads((folder / "found.json").read_text())
    del document["data"]
    (folder / "before.json").write_text(json.dumps(document))
    said = run("sugiyama report other.mcap --diagnosis before.json")
    assert said.code == 0
    assert said.err.startswith("warning: before.json: does not say which recording it is of")


def test_a_diagnosis_without_files_says_how_to_keep_it_with_its_options(run, added):
    said = run("sugiyama diagnose ring.csv --ring 56 --simulations 1 --seed 5")
    assert said.code == 0, said.err
    (again,) = [step for step in said.steps if step.startswith("sugiyama diagnose") and "--save" in step]
    for option in ("--ring 56", "--simulations 1", "--seed 5", "--save diagnosis.json"):
        assert option in again
    found = "with what was added" in said.out
    assert ("-o model.yaml" in again) == found
    assert ("By driver, before and after" in said.out) == found


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ("telepathy", "sugiyama effects"),
        ("discovered_force:mood", "time_gap"),
        ("auto,drag", "give auto alone"),
        (",", "has no name"),
    ],
)
def test_what_cannot_be_added_is_refused_at_once(run, added, asked, why):
    said = run(f"sugiyama diagnose ring.csv --ring 56 --add {asked}")
    assert said.code == 2
    assert len(said.err.splitlines()) == 1
    assert why in said.err


def test_a_model_with_cautions_says_so_wherever_it_drives(run, added, folder):
    model = yaml.safe_load((folder / "model.yaml").read_text())
    caution = "15 cars collide in free runs into the last part instead of 3"
    (folder / "careful.yaml").write_text(yaml.safe_dump(model | {"cautions": [caution]}))
    for command in (
        "run ring.csv --ring 56 --model careful.yaml -o careful.mcap",
        "simulate --vehicles 5 --ring 56 --duration 10 --model careful.yaml -o careful.csv",
    ):
        said = run(f"sugiyama {command}")
        assert said.code == 0, said.err
        assert f"caution: careful.yaml: {caution}" in said.err
    (folder / "wrong.yaml").write_text(yaml.safe_dump(model | {"cautions": 15}))
    assert "cautions: give a list" in run("sugiyama run ring.csv --ring 56 --model wrong.yaml -o x.mcap").err


def test_python_adds_writes_and_reports_as_the_command_line(run, folder, added):
    assert run("sugiyama run ring.csv --ring 56 -o seen.mcap").code == 0
    recording = sg.read(folder / "ring.csv", ring_m=56.0)
    with pytest.raises(InputError, match="telepathy"):
        sg.diagnose(recording, add=["telepathy"])
    with pytest.raises(InputError, match="simulations: 0 is not possible"):
        sg.diagnose(recording, simulations=0)
    with pytest.raises(InputError, match="simulations: 1001 is not possible; give 1 to 1000"):
        sg.diagnose(recording, simulations=1001)
    found = sg.diagnose(recording, simulations=1, seed=4, add="clock_offset")
    first = json.loads((folder / "found.json").read_text())["verdict"]["effects"][0]
    assert found.steps[0].gain["all"].nats == pytest.approx(first["heldout_gain_nats"])
    assert "clock_offset" in found.summary()
    found.save(folder / "python.json")
    for given in (found, folder / "python.json"):
        page = sg.report(folder / "seen.mcap", folder / "python.html", given)
        # the form, not the mechanism
        card = page.read_text().split("<nav>")[0]
        assert "clocks that differ (clock_offset)" in card
        assert "How large</dt><dd>A value of each driver</dd>" in card
