"""The demo: it finds what was hidden, the published errors fall, and terminal and page say the same."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
SUGIYAMA = [sys.executable, "-m", "sugiyama_ros.cli"]


def tell_alike(said, page):
    """Assert that the terminal and the card of the page tell the same numbers of the effect that was found."""
    terminal = " ".join(said["verdict"]["told"])
    card = page.split("<nav>")[0].replace("\N{NO-BREAK SPACE}", " ")
    (found,) = said["verdict"]["effects"]
    ends = [f"{said['errors'][when]['free_run_10s_m']:.2f}" for when in ("before", "after")]
    reduction = found["parameters"]["reduction"]
    pairs = [(" -> ".join(f"{end} m" for end in ends), " → ".join(ends))]
    pairs.append((f"reduction = {reduction:.3f} ±", f"{reduction:.3f} ±"))
    pairs.append((f"{round(found['heldout_gain_nats'])} ± {round(found['heldout_gain_se'])} nats",) * 2)
    for when in ("before", "after"):
        pairs.append((f"{len(said['where'][when]['flagged'])} of {len(said['where'][when]['bins'])}",) * 2)
    for of_terminal, of_card in pairs:
        assert of_terminal in terminal
        assert of_card in card


def figures_of_readme(said):
    """What README says of the demo, with the figures that it has printed."""
    (found,) = said["verdict"]["effects"]
    value, std = found["parameters"], found["parameters_std"]
    before, after = (said["errors"][when]["free_run_10s_m"] for when in ("before", "after"))
    return (
        f"**{100.0 * value['reduction']:.1f} ± {100.0 * std['reduction']:.1f} % at"
        f" {value['centre']:.1f} ± {std['centre']:.1f} m**."
        f" The error of a forecast over 10 s fell from **{before:.1f} to {after:.1f} m**."
    )


def test_demo_finds_the_hidden_effect_and_the_published_error_falls(tmp_path):
    command = [*SUGIYAMA, "demo", "--hidden", "slow_patch", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    said = json.loads(done.stdout)
    (found,) = said["verdict"]["effects"]
    assert found["name"] == said["hidden"]["name"] == "slow_patch"
    assert found["parameters"]["centre"] == pytest.approx(said["hidden"]["parameters"]["centre"], abs=10.0)
    assert found["heldout_gain_nats"] > 2.0 * found["heldout_gain_se"]
    published = said["published_one_step_rmse_m"]
    assert published["after"] < published["before"]
    # the hidden effect hurts visibly
    assert said["errors"]["after"]["free_run_10s_m"] < 0.67 * said["errors"]["before"]["free_run_10s_m"]
    page = (tmp_path / "sugiyama-demo.html").read_text()
    assert "<dt>What was hidden</dt><dd>Slower stretch of road" in page
    tell_alike(said, page)
    assert figures_of_readme(said) in re.sub(r"\s+", " ", README.read_text())
    assert said["messages_lost"] == 0
    assert (tmp_path / "sugiyama-demo.mcap").exists()
