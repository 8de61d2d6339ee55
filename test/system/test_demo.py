"""The demo: it finds what was hidden, the published errors fall, and terminal and page say the same."""

import json
import subprocess
import sys

import pytest

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
    assert said["messages_lost"] == 0
    assert (tmp_path / "sugiyama-demo.mcap").exists()
