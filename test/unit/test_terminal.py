"""What commands print: texts from files are characters, and never commands to the terminal."""

import re
from pathlib import Path

import pytest
import yaml

import sugiyama_ros as sg
from sugiyama_ros.cli import data
from sugiyama_ros.cli.app import app
from sugiyama_ros.cli.output import print_cautions, print_line, print_note, print_table
from sugiyama_ros.errors import InputError
from sugiyama_ros.results import TextTable

#: Colours, a cleared screen, a title, an eight-bit sequence, text from right to left, and markup.
EVIL = "\x1b[31mred\x1b[2J\x1b]0;title\x07\x9b31m\u202e[bold]x[/]"
STEERS = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def test_lines_notes_and_tables_steer_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_line(f"first\nsecond {EVIL}")
    print_note(EVIL)
    print_table(TextTable(EVIL, (EVIL, "b"), ((EVIL, "2"),)))
    out, err = capsys.readouterr()
    assert not STEERS.search(out + err)
    assert out.startswith("first\nsecond  [31mred [2J")
    assert "[bold]x[/]" in err


def test_names_in_a_recording_steer_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated = sg.simulate(vehicles=2, ring_m=0.0, duration_s=10.0).measured
    names = {str(k): f"{EVIL}{k}" for k in range(2)}
    frame = simulated.to_frame().assign(lane=EVIL, recording=EVIL, leader=None)
    frame["class"] = EVIL
    frame["controlled"] = 1
    frame["vehicle"] = frame["vehicle"].astype(str).map(names)
    frame.to_csv(tmp_path / "evil.csv", index=False)
    data.info([tmp_path / "evil.csv"])
    data.info([tmp_path / "evil.csv"], as_json=True)
    out, err = capsys.readouterr()
    assert "31mred" in out
    assert not STEERS.search(out + err)


def test_cautions_of_a_model_steer_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.yaml"
    sg.calibrate(sg.simulate(vehicles=2, ring_m=0.0, duration_s=30.0)).save(path)
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), "cautions": [f"{EVIL}\nerror: not mine"]}))
    print_cautions(path)
    err = capsys.readouterr().err
    assert err.startswith("caution: ")
    assert err.count("\n") == 1
    assert not STEERS.search(err)


def test_a_bag_that_is_not_there_is_called_missing(tmp_path: Path) -> None:
    (tmp_path / "nope.recovered.mcap").touch()
    with pytest.raises(InputError, match="nope: cannot be read: No such file or directory; check the name"):
        data.recover(tmp_path / "nope", overwrite=True)


@pytest.mark.parametrize(
    ("given", "what"),
    [
        (["info", ""], "files"),
        (["compare", "a.csv", ""], "sources"),
        (["compare", "a.csv", "--model", ""], "model"),
        (["simulate", "-o", ""], "output"),
    ],
)
def test_an_empty_name_is_not_the_current_folder(given: list[str], what: str) -> None:
    with pytest.raises(InputError, match=f"{what}: is empty; give the name of a file or a folder"):
        app(given, standalone_mode=False)


def test_an_error_steers_no_terminal() -> None:
    assert not STEERS.search(str(InputError(EVIL)))
