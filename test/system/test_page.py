"""The page, in a real browser where there is one: all panels, no error in its console, nothing from the network."""

import contextlib
import json
import math
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from http.client import HTTPConnection
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import Div, GlyphRenderer, Select
from bokeh.util.token import generate_jwt_token
from diagnoses import addition, document, fails, force, gains
from PIL import Image

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.page import live
from sugiyama_ros.page.diagnosis import read_diagnosis
from sugiyama_ros.page.feed import KEPT, Log, Status
from sugiyama_ros.page.live import status_line
from sugiyama_ros.page.recording import read_recording
from sugiyama_ros.page.report import detectable, report, write_report
from sugiyama_ros.page.words import WHY, beside_the_verdict
from sugiyama_ros.road import Road

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
ROOT = Path(__file__).parents[2]
SUGIYAMA = str(Path(sys.executable).with_name("sugiyama"))
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# Length of the longest line of data that a page of Bokeh holds.
LONGEST_SOURCE = """Math.max(...[...Bokeh.documents[0]._all_models.values()]
    .filter(m => m.type == "ColumnDataSource").map(m => m.get_length() ?? 0))"""
PATCH = addition(indistinguishable=["road_grade"], advice=["survey the road"])
DIAGNOSIS = document("explained", [PATCH, force(step=1)]) | {
    "hidden": {"name": "slow_patch", "parameters": {"reduction": 0.21}}
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Six cars on a ring, run through the estimators."""
    folder = tmp_path_factory.mktemp("page")
    for arguments in (
        ("simulate", "-o", "sim.mcap", "--vehicles", "6", "--ring", "80", "--duration", "40"),
        ("run", "sim.mcap", "-o", "run.mcap", "--critic"),
    ):
        command = [SUGIYAMA, *arguments]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def page(recorded):
    (recorded.parent / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    output = recorded.with_suffix(".html")
    write_report(read_recording(recorded), read_diagnosis(recorded.parent / "diagnosis.json"), output)
    return output


def test_what_was_recorded_is_read_back(recorded):
    r = read_recording(recorded)
    assert r.trajectories.position_m.shape == (121, 6)
    assert r.has_estimates
    assert np.isfinite(r.series["speed"][5:]).all()
    scored = r.series["scored"] > 0.0
    assert 0.05 < np.sqrt(np.mean(r.series["innovation_m"][scored] ** 2)) < 1.0
    assert set(r.weights) >= {"base"}
    assert np.sum(list(r.weights.values()), axis=0) == pytest.approx(1.0)


def test_the_page_of_another_law_shows_the_parameters_of_that_law(recorded):
    bag = recorded.parent / "idm.mcap"
    command = [SUGIYAMA, "run", recorded.parent / "sim.mcap", "--law", "idm", "-o", bag]
    subprocess.run(command, capture_output=True, check=True)
    r = read_recording(bag)
    assert r.learnt == ["idm.v0", "idm.T", "idm.s0", "idm.a", "idm.b"]
    text = report(r, None)
    assert "Learnt: desired time gap T" in text
    assert "Learnt: desired speed v*" not in text


def test_no_page_asks_for_anything_from_elsewhere(page):
    text = page.read_text()
    assert len(text) < 5_000_000
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?https?:", text)


def test_the_card_says_what_how_much_how_sure_and_what_to_do(recorded):
    text = report(read_recording(recorded), {**DIAGNOSIS, "verdict": {**DIAGNOSIS["verdict"], "effects": [PATCH]}})
    card = text.split("<nav>")[0].replace("\u00a0", " ")
    for words in (
        "What was missing is explained",
        "Slower stretch of road (slow_patch).</p><p>With it, no check fails.",
        "Share taken off the desired speed: 0.20 ± 0.01; middle: 5 m; length: 30 m",
        "Unseen data confirm it: 50 ± 9 nats better (5.6 standard errors); chance gains as much with p &lt; 0.001",
        "cannot be told apart from hill",
        "To tell apart what cannot be told apart, survey the road.",
        "3.00 → 1.50 m <span>(-50 %)</span>",
        "<dt>What was hidden</dt><dd>Slower stretch of road; share",
        "<h3>Checks that hold</h3>",
        "2 of 2",
        "<td>after</td><td>1 of 2</td>",
    ):
        assert words in card


def test_failed_checks_are_named_on_the_card_and_all_checks_stand_below(recorded):
    failed = fails("bias_over_place", 6.3, 1.1)
    d = document("not_explained", [PATCH], [failed])
    card, below = report(read_recording(recorded), d).replace("\u00a0", " ").split("<nav>", 1)
    assert "Not explained" in card
    assert "2 of 3" in card
    assert "fails: bias over the place" in card
    assert "Checks of the final model: 2 of 3 checks hold" in below
    rows = re.findall(
        r"<tr><td>([^<]*)</td><td>([^<]*)</td><td>([^<]*)</td><td>([^<]*)</td><td>(holds|fails)</td>", below
    )
    assert [row[-1] for row in rows] == ["fails", "holds", "holds"]
    assert rows[0][1:4] == ("6.3", "1.1", "p 0.001")
    assert ("mean speed", "5 m/s", "5.1 m/s", "p 0.4", "holds") in rows


def test_what_the_data_would_have_shown_is_said_with_its_direction():
    about = {
        "reaction_delay": {"title": "reaction time", "parameters": {"delay": {"unit": "s", "meaning": "delay"}}},
        "limited_braking": {
            "title": "weak brakes",
            "is_limit": True,
            "parameters": {"limit": {"unit": "m/s^2", "meaning": "hardest braking"}},
        },
    }
    sizes = [("reaction_delay", "delay", 0.03), ("limited_braking", "limit", 3.4)]
    smallest = [dict(zip(("name", "parameter", "value"), one, strict=True)) for one in sizes]
    text = detectable({**DIAGNOSIS, "smallest_detectable": smallest, "about": about}).replace("\u00a0", " ")
    assert "delay: 0.03 s or more" in text
    assert "hardest braking: 3.4 m/s² or less" in text


# Boxes of all cells of the report, by the top: left, top, right, bottom [pixels].
CELLS = """[...document.querySelectorAll(
        ".card > *, .tile, .panel, .text, section > p, section > .scroll > table, .tile td")]
    .filter(e => !e.matches(".tiles, details:not([open]) *")).map(e => { const r = e.getBoundingClientRect();
        return [r.left, r.top + scrollY, r.right, r.bottom + scrollY, e.matches("td, .tile") ? 1 : 0] })
    .filter(b => b[2] > b[0] && b[3] > b[1])"""
READY = "window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].is_idle"
# Place [pixels] of a point of a plot in the window; the plot is scrolled into view.
POINT = """([title, x, y]) => {
    const [plot] = [...Bokeh.index.query(v => v.model.type == "Figure" && v.model.title.text == title)]
    plot.el.scrollIntoView({block: "center"})
    const box = plot.canvas_view.el.getBoundingClientRect()
    return [box.left + plot.frame.x_scale.compute(x), box.top + plot.frame.y_scale.compute(y)]
}"""
# Speeds that panels of the chosen driver show, as one number.
SHOWN = """[...Bokeh.documents[0]._all_models.values()].filter(m => m.type == "ColumnDataSource" && m.data.meant)
    .map(m => m.data.meant.slice(-5).join())"""
# Plots that have a legend; the middles [pixels] of a legend's entries in the window; which curves of a plot are drawn.
LEGENDS = """[...Bokeh.index.query(v => v.model.type == "Legend")].map(v => v.parent.model.title.text)"""
LEGEND = """title => {
    const [legend] = [...Bokeh.index.query(v => v.model.type == "Legend" && v.parent.model.title.text == title)]
    legend.el.scrollIntoView({block: "center"})
    return legend.entries.map(e => e.el.getBoundingClientRect()).map(b => [b.left + b.width / 2, b.top + b.height / 2])
}"""
DRAWN = """[...Bokeh.index.query(v => v.model.type == "Figure" && v.model.title.text == TITLE)][0]
    .model.renderers.filter(r => r.visible).length"""
# Width [pixels] of the narrowest panel, and the height of a panel.
NARROWEST = (
    """Math.floor(Math.min(...[...document.querySelectorAll(".panel")].map(e => e.getBoundingClientRect().width)))"""
)
PANEL_PX = 320
# Place of the left axis of a plot in the window: left, top, width, height [pixels].
AXIS = """title => {
    const [plot] = [...Bokeh.index.query(v => v.model.type == "Figure" && v.model.title.text == title)]
    plot.el.scrollIntoView({block: "center"})
    const box = plot.canvas_view.el.getBoundingClientRect()
    return [box.left, box.top + plot.frame.bbox.top, plot.frame.bbox.left, plot.frame.bbox.height]
}"""


@pytest.fixture(scope="module")
def browser():
    """One Chromium for all tests of pages."""
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield launched
        launched.close()


def test_the_report_in_a_browser(browser, page):
    problems, asked = [], []
    context = browser.new_context(viewport={"width": 800, "height": 800})
    shown = context.new_page()
    shown.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    shown.on("pageerror", lambda error: problems.append(str(error)))
    shown.on("request", lambda request: asked.append(request.url))
    shown.goto(page.as_uri())
    shown.wait_for_function(READY)
    for width, scheme in ((800, "light"), (1280, "dark"), (1920, "light")):
        shown.emulate_media(color_scheme=scheme)
        shown.set_viewport_size({"width": width, "height": 800})
        shown.wait_for_function(READY)
        shown.wait_for_timeout(200)
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        back = shown.evaluate("getComputedStyle(document.body).backgroundColor")
        assert back == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 20, 20)"}[scheme]
        check_layout(np.array(shown.evaluate(CELLS)), width, shown.evaluate(NARROWEST))
        # the numbers at the axes can be read: darker than the page, or brighter
        grey = brightness_of_axis(shown, "Speeds of all vehicles")
        assert grey.min() < 100 if scheme == "light" else grey.max() > 150
    choose_drivers(shown, page.with_suffix(".mcap"))
    hover(shown)
    click_legends(shown)
    # the road from above plays, and stops
    slider = "[...Bokeh.index.query(v => v.model.type == 'Slider')][0].model.value"
    start = shown.evaluate(slider)
    shown.get_by_role("button", name="play").click()
    shown.wait_for_function(f"{slider} > {start}")
    shown.get_by_role("button", name="pause").click()
    # by the keyboard, too
    shown.get_by_role("button", name="play").focus()
    shown.keyboard.press("Enter")
    shown.get_by_role("button", name="pause").focus()
    shown.keyboard.press("Enter")
    assert shown.get_by_role("button", name="play").is_visible()
    start = shown.evaluate(slider)
    shown.get_by_role("slider").first.focus()
    shown.keyboard.press("ArrowLeft")
    shown.wait_for_function(f"{slider} < {start}")
    # what is folded opens by the keyboard; the links of the top lead to their sections
    shown.locator("#missing summary").first.focus()
    shown.keyboard.press("Enter")
    assert shown.get_by_text("The error of a forecast over 10 s falls").is_visible()
    shown.get_by_role("link", name="What it is worth").focus()
    shown.keyboard.press("Enter")
    shown.wait_for_function("document.querySelector('#worth').getBoundingClientRect().top < 400")
    assert 0 <= shown.evaluate("document.querySelector('#worth').getBoundingClientRect().top") < 400
    assert shown.pdf(format="A4").startswith(b"%PDF")
    context.close()
    assert problems == []
    assert asked == [page.as_uri()]


def test_the_card_fits_one_screen(browser, recorded, tmp_path):
    # as much as a verdict has to say: many additions that leave a lot unexplained
    kept = [{**PATCH, "name": f"slow_patch_{k}", "advice": []} for k in range(6)]
    checks = [fails(f"left_for_force_along_{name}", 30.0, 0.0, unit="nats") for name in ("gap", "speed", "time_gap")]
    d = document("not_explained", kept, [*checks, fails("gain_of_gipps", 517.0, 0.0, unit="nats")])
    d["errors"]["after"]["gains"] = gains(-40.0, 5.0)
    write_report(read_recording(recorded), d, tmp_path / "card.html")
    for width, height in ((800, 1000), (1280, 800), (1920, 800)):
        shown = browser.new_page(viewport={"width": width, "height": height})
        shown.goto((tmp_path / "card.html").as_uri())
        shown.wait_for_function(READY)
        assert shown.evaluate("document.querySelector('.card').getBoundingClientRect().bottom") < height
        shown.close()


def brightness_of_axis(shown, title):
    """Brightness of the pixels of the left axis of a plot, 0 to 255."""
    left, top, width, height = shown.evaluate(AXIS, title)
    shown.wait_for_timeout(300)  # until the picture is drawn
    picture = shown.screenshot(clip={"x": left, "y": top, "width": width, "height": height})
    return np.asarray(Image.open(BytesIO(picture)).convert("L"))


def choose_drivers(shown, recorded):
    """Choose drivers by the keyboard and by clicks; everything follows each time."""
    selected = """[...Bokeh.documents[0]._all_models.values()].filter(m => m.type == "ColumnDataSource")
        .map(m => m.selected.indices).filter(i => i.length == 1).map(i => i[0])"""
    chosen = "[...Bokeh.index.query(v => v.model.type == 'Select')][0].model.value"
    seen = [shown.evaluate(SHOWN)]

    def follows(driver):
        shown.wait_for_function(f"{chosen} == 'vehicle {driver}'")
        shown.wait_for_function(f"({selected}).filter(i => i == {driver}).length >= 3")
        seen.append(shown.evaluate(SHOWN))
        assert seen[-1] != seen[-2]

    shown.get_by_role("combobox").focus()
    shown.keyboard.press("ArrowDown")
    shown.keyboard.press("ArrowDown")
    follows(2)
    clicks = {
        "The drivers, as fitted, ± one deviation": (4, 14.0, 0.2),
        "Free runs of one car, 10 s: each driver": (5, "5", 1.5),
    }
    for title, (driver, x, y) in clicks.items():
        shown.mouse.click(*shown.evaluate(POINT, [title, x, y]))
        follows(driver)
    car = "[...Bokeh.index.query(v => v.model.title?.text == 'The road from above')][0]"
    car = f"{car}.model.renderers.map(r => r.data_source.data).filter(d => d.vehicle)[0]"
    place = shown.evaluate(f"(d => [d.x[1], d.y[1]])({car})")
    shown.mouse.click(*shown.evaluate(POINT, ["The road from above", *place]))
    follows(1)
    # the middle of a driver's line between two samples
    r = read_recording(recorded)
    place = r.trajectories.road.wrap(r.trajectories.position_m)
    k = next(k for k in range(60, 120) if abs(place[k + 1, 3] - place[k, 3]) < 10.0)
    middle = [float(a[k : k + 2].mean()) for a in (r.time_s, place[:, 3])]
    shown.mouse.click(*shown.evaluate(POINT, ["Simulated", *middle]))
    follows(3)


def hover(shown):
    """Move the mouse over points of plots: each says its numbers, with units."""
    points = {
        "Gain, ± one standard error": ((25.0, "▸ slower stretch of road (p 0.5)"), "50 nats"),
        "Free runs of all cars together": ((6.0, 1.8), "base model"),
        "Free runs of one car, 10 s: each driver": (("3", 1.5), "2.00 m"),
        "Bias over speed and gap, before": ((23.0, 10.0), "-0.40 std"),
        "The drivers, as fitted, ± one deviation": ((13.0, 0.2), "13.000 m/s"),
    }
    for title, (point, says) in points.items():
        x, y = shown.evaluate(POINT, [title, *point])
        said = shown.locator(".bk-Tooltip").get_by_text(says, exact=True).first
        assert not said.is_visible(), title
        shown.mouse.move(x, y)
        said.wait_for(timeout=30_000)
        shown.mouse.move(2.0, 2.0)
        said.wait_for(state="hidden", timeout=30_000)


def click_legends(page):
    """Click each entry of each legend: one curve or more disappear, and come back with a second click."""
    titles = page.evaluate(LEGENDS)
    for title in titles:
        drawn = DRAWN.replace("TITLE", json.dumps(title))
        for place in page.evaluate(LEGEND, title):
            whole = page.evaluate(drawn)
            page.mouse.click(*place)
            page.wait_for_function(f"{drawn} < {whole}")
            page.mouse.click(*place)
            page.wait_for_function(f"{drawn} == {whole}")
    return titles


def check_layout(cells, width, narrowest):
    """No two cells overlap but those inside a tile, no text leaves its tile, and no void is larger than a panel.

    narrowest: width [pixels] of the narrowest panel.
    """
    inside, cells = cells[cells[:, 4] > 0, :4], cells[:, :4]
    tiles = inside[inside[:, 3] - inside[:, 1] > 100]
    for left, top, right, bottom in inside:
        held = (tiles[:, 0] <= left) & (right <= tiles[:, 2]) & (tiles[:, 1] <= top) & (bottom <= tiles[:, 3])
        assert held.any(), (width, left, top)
    outer = np.array([c for c in cells if not any(np.array_equal(c, i) for i in inside) or c[3] - c[1] > 100])
    for k, (left, top, right, bottom) in enumerate(outer):
        others = outer[k + 1 :]
        across = np.minimum(right, others[:, 2]) - np.maximum(left, others[:, 0])
        along = np.minimum(bottom, others[:, 3]) - np.maximum(top, others[:, 1])
        assert not np.any((across > 1.0) & (along > 1.0)), (width, outer[k])
    covered = np.zeros((int(outer[:, 3].max()) + 1, width), dtype=int)
    for left, top, right, bottom in outer.astype(int):
        covered[top:bottom, left:right] = 1
    assert not has_void(covered, PANEL_PX, narrowest)


def has_void(covered, height, width):
    """Whether a rectangle of so many pixels is nowhere covered."""
    summed = np.pad(covered.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    inside = summed[height:, width:] - summed[:-height, width:] - summed[height:, :-width] + summed[:-height, :-width]
    return bool((inside == 0).any())


def free_port():
    """A port that nothing holds at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def live_page(browser, *arguments):
    """A live page in Chromium. At the end, its console has no error, and it has asked no other machine for anything."""
    port = free_port()
    command = [SUGIYAMA, "live", *arguments, "--port", port]
    served = subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True)
    problems, asked = [], set()
    try:
        address = f"http://localhost:{port}"
        assert any(address in line for line in iter(served.stderr.readline, ""))
        context = browser.new_context()
        page = context.new_page()
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("request", lambda request: asked.add(request.url.split("/")[2]))
        page.goto(address)
        yield page
        context.close()
    finally:
        served.send_signal(signal.SIGINT)
        _, said = served.communicate(timeout=60)
    assert served.returncode == 0
    # the last words say where the recording is; nothing warns
    end = [f"all topics are in {path}; look at it: sugiyama report {path} --open" for path in arguments[-1:]]
    assert said.splitlines() == end
    assert problems == []
    assert asked == {f"localhost:{port}"}


# Boxes of what stands on a live page: left, top, right, bottom [pixels].
SHOWN_LIVE = """[...Bokeh.index.query(v => !v.model.children && v.model.visible && v.el?.getBoundingClientRect)]
    .filter(v => ["Figure", "Button", "Toggle", "Select", "TextInput", "Div"].includes(v.model.type))
    .map(v => v.el.getBoundingClientRect()).filter(b => b.width * b.height > 0)
    .map(b => [b.left, b.top, b.right, b.bottom])"""


def check_live_layout(page):
    """At each width, dark and light, nothing overlaps, and nothing is cut off."""
    for width, scheme in ((800, "dark"), (1280, "light"), (1920, "dark")):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_timeout(1000)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        back = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert back == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 20, 20)"}[scheme]
        boxes = np.array(page.evaluate(SHOWN_LIVE))
        assert len(boxes) > 15
        for k, (left, top, right, bottom) in enumerate(boxes):
            across = np.minimum(right, boxes[k + 1 :, 2]) - np.maximum(left, boxes[k + 1 :, 0])
            along = np.minimum(bottom, boxes[k + 1 :, 3]) - np.maximum(top, boxes[k + 1 :, 1])
            assert not np.any((across > 1.0) & (along > 1.0)), (width, boxes[k])


def test_every_control_of_the_live_page(browser, recorded, tmp_path):
    arguments = (recorded.parent / "sim.mcap", "--rate", 2, "-o", tmp_path / "live.mcap")
    with live_page(browser, *arguments) as page:
        page.get_by_text("one-step error over").wait_for(timeout=60_000)
        page.get_by_role("button", name="pause").click()
        # under a heavy load, the recording may have ended before
        page.get_by_text(re.compile(r", (silent for \d+ s|ended)")).wait_for(timeout=60_000)
        check_live_layout(page)
        # the driver: by the list, by a car, by a point
        driver = page.get_by_label("driver", exact=True)
        speeds = "[...Bokeh.documents[0]._all_models.values()].map(m => m.data).filter(d => d?.spread)[0].speed.join()"
        first = page.evaluate(speeds)
        driver.select_option("vehicle 3")
        page.wait_for_function(f"{speeds} != {json.dumps(first)} && {speeds}.length > 0")
        found = "[...Bokeh.documents[0]._all_models.values()].map(m => m.data).filter(d => d?.vehicle && d.{0})[0]"
        for title, x, y in (
            ("The road from above: click a car", "x", "y"),
            ("All drivers now: click one", "v_star", "kappa_v"),
        ):
            data = found.replace("{0}", x)
            k = 1 if x == "x" else 4
            vehicle, *point = page.evaluate(f"(d => [d.vehicle[{k}], d.{x}[{k}], d.{y}[{k}]])({data})")
            page.mouse.click(*page.evaluate(POINT, [title, *point]))
            chosen = "[...Bokeh.index.query(v => v.model.type == 'Select' && v.model.title == 'driver')][0].model.value"
            page.wait_for_function(f"{chosen} == 'vehicle {vehicle}'")
        # an effect: what it is, its strength, and an answer to a strength that is none
        page.get_by_label("effect", exact=True).select_option("drag")
        page.get_by_text("c0 [m/s²]: constant resistance").wait_for()
        strength = page.get_by_label("strength", exact=True)
        strength.fill("much")
        strength.press("Enter")
        page.get_by_role("button", name="add").click()
        page.get_by_text("much is not NAME=VALUE").wait_for()
        strength.fill("c0=0.1, c2=0.001")
        strength.press("Enter")
        page.get_by_role("button", name="add").click()
        page.get_by_text("drag added (c0=0.1, c2=0.001)").wait_for()
        assert len(click_legends(page)) == 2
        # a page that is loaded again, or in a second window, shows the samples before
        shown = page.evaluate(LONGEST_SOURCE)
        again = page.context.new_page()
        again.goto(page.url)
        again.get_by_text("one-step error over").wait_for(timeout=60_000)
        assert again.evaluate(LONGEST_SOURCE) >= shown > 20
        again.close()
        # on to the end, faster; then the page says how to make a report
        page.get_by_label("rate", exact=True).select_option("8")
        page.get_by_role("button", name="pause").click()
        page.get_by_text(re.compile("of 40 s, ended")).wait_for(timeout=90_000)
        assert page.get_by_text(re.compile("sugiyama report .* --open")).is_visible()
    assert read_recording(tmp_path / "live.mcap").has_estimates
    with Bag(tmp_path / "live.mcap") as bag:
        names = [m.message.name for m in bag.messages(["/vehicle_03/parameters"])]
    assert "drag.c0" in names[-1]
    assert "drag.c0" not in names[0]


def test_the_live_page_at_the_fastest_rate_draws_what_was_published(browser, recorded, tmp_path):
    """Each filtered speed stands at its own time, from the first sample on, of the driver with the lowest number."""
    with live_page(browser, recorded.parent / "sim.mcap", "--rate", "max", "-o", tmp_path / "live.mcap") as page:
        empty = page.locator("canvas").count()
        page.get_by_text(re.compile(r"of 40 s, ended")).wait_for(timeout=90_000)
        page.wait_for_timeout(1500)
        data = "[...Bokeh.documents[0]._all_models.values()].map(m => m.data).filter(d => d?.spread)[0]"
        time_s, speed, place = (page.evaluate(f"[...{data}.{name}]") for name in ("time", "speed", "place"))
        assert page.get_by_label("driver", exact=True).input_value() == "vehicle 0"
        rate = page.get_by_label("rate", exact=True)
        assert rate.locator("option").all_inner_texts() == ["1", "2", "4", "8", "max"]
        assert rate.locator("option:checked").inner_text() == "max"
        assert page.locator("canvas").count() > 20
    # a first view has no empty boxes: each picture comes when there is something to draw
    assert empty == 0
    r = read_recording(tmp_path / "live.mcap")
    assert time_s == pytest.approx(r.time_s.tolist())
    assert speed[1:] == pytest.approx(r.series["speed"][1:, 0].tolist())
    assert place == pytest.approx(r.trajectories.position_m[:, 0].tolist())


def test_adding_the_true_effect_lowers_the_error_on_the_page(browser, tmp_path):
    # cars of limited power, measured so well that the model causes the one-step error: 0.110 m, 0.100 m with the effect
    settings = ("--effect", "limited_power:power=10", "--set", "sigma_nu=0.03", "--set", "sigma_a=0.15")
    command = [SUGIYAMA, "simulate", "-o", tmp_path / "sim.mcap", "--duration", "160", *settings]
    subprocess.run(command, check=True, capture_output=True)

    def shown(page, until_s):
        """Errors [m] of estimators and base model that the page shows until a time [s] of the recording, by time."""
        read = {}
        while not read or max(read) < until_s:
            text = page.get_by_text("one-step error over").inner_text()
            pattern = r"(\d+) s: one-step error over 10 s ([\d.]+) m, base model ([\d.]+) m"
            if found := re.search(pattern, text):
                time_s, *errors = map(float, found.groups())
                read[time_s] = errors
            page.wait_for_timeout(250)
        return read

    with live_page(browser, tmp_path / "sim.mcap", "--rate", 10, "-o", tmp_path / "live.mcap") as page:
        page.get_by_text("effects added: none").wait_for(timeout=60_000)
        before = shown(page, 60)
        page.get_by_label("effect", exact=True).select_option("limited engine power")
        page.get_by_role("button", name="add").click()
        page.get_by_text("effects added: limited engine power").wait_for(timeout=60_000)
        after = shown(page, 150)
    parts = ((before, 25), (after, 95))
    (first, base), (last, still) = (np.mean([e for t, e in part.items() if t > since], axis=0) for part, since in parts)
    # estimators and base model see the same samples; without an effect they are the same
    assert first == pytest.approx(base, rel=1e-3)
    assert last < 0.96 * still


def test_the_status_line_says_where_the_recording_is_and_what_to_do():
    status = Status("a.csv", 20.0, 20.0, math.nan, 0.1, True, "7", "out.mcap")
    feed = SimpleNamespace(vehicles=[0, 1], now={0: (0.0, 1.0)})
    said = status_line(status, feed)
    assert "20 of 20 s, ended" in said
    assert "sugiyama report out.mcap --open" in said
    assert "silent for 9 s" in status_line(status._replace(ended=False, silent_s=9.0), feed)
    waiting = status_line(status._replace(source=""), SimpleNamespace(vehicles=[]))
    assert "Waiting for a road on /road and positions on /measured, in ROS domain 7" in waiting
    assert "sugiyama live FILE" in waiting


def feed_of_a_critic(gains):
    """What a page needs to know while nobody is on the road and a critic speaks."""
    nobody = dict.fromkeys(("vehicles", "changed_s", "events", "added"), ())
    nothing = {name: {} for name in ("now", "lanes", "driver", "learnt", "adapted")}
    status = Status("", 0.0, 0.0, math.nan, math.nan, False, "7", "")
    logs, titles = {name: Log(KEPT) for name in gains}, {"second_leader": "look past the leader"}
    return SimpleNamespace(
        road=Road(60.0), rate=1.0, effects={"drag": "", "second_leader": ""}, titles=titles, said="", space=Log(1),
        error=Log(1), gains=gains, critic=logs, is_settled=False, status=lambda: status, values=lambda name: "",
        best="second_leader", followers=(), led=(), here=(), yielding=(),
        **nobody, **nothing,
    )  # fmt: skip


def test_a_page_shows_a_critic_whose_models_change():
    # drag is added to the estimators, so that the critic compares with a model that has it
    feed = feed_of_a_critic({"base": 0.0, "drag": 7.0, "second_leader": 2.0})
    for name, log in feed.critic.items():
        log.add(1.0, feed.gains[name])
    feed.gains, feed.is_settled, feed.added = {"base": 0.0, "second_leader": 3.0}, True, ("drag",)
    for name in feed.gains:
        feed.critic[name].add(6.0, feed.gains[name])
    document = Document()
    live.page(feed)(document)
    told = " ".join(div.text for div in document.select({"type": Div}))
    assert (
        "settled among the models that this critic knows: look past the leader leads by 3 nats only, which may be"
        in told
    )
    # why a diagnosis may find something else; all effects that can be added are known to this critic
    assert WHY in told
    assert "does not follow" not in told
    drawn = {line.name: line.data_source.data for line in document.select({"type": GlyphRenderer}) if line.name}
    assert {name: list(data["gain"]) for name, data in drawn.items()} == {
        "base": [0.0, 0.0],
        "drag": [7.0],
        "second_leader": [2.0, 3.0],
    }


@pytest.mark.parametrize(
    ("best", "added", "words"),
    [
        ("slow_patch", (), "finds slower stretch of road missing. The verdict above says the same."),
        ("road_grade", (), "finds hill missing. The verdict above cannot tell it apart from slower stretch of road."),
        ("drag", (), f"finds drag missing. The verdict above is another one, and it counts: {WHY}."),
        ("base", (), f"finds nothing missing. The verdict above is another one, and it counts: {WHY}."),
        ("base", ("slow_patch",), "nothing missing, beyond what the estimators had already (slower stretch of road)."),
    ],
)
def test_critic_and_verdict_say_the_same_or_why_not(best, added, words):
    assert words in beside_the_verdict(DIAGNOSIS, best, added)
    assert beside_the_verdict(None, best, added).endswith(f"This is no verdict: {WHY}.")


def test_the_live_page_follows_another_driver_when_its_own_choice_has_left():
    feed = feed_of_a_critic({"base": 0.0})
    feed.driver, feed.learnt = ({v: Log(KEPT) for v in (1, 2, 3)} for _ in range(2))
    # whose estimates come first does not matter: those who have a leader are known from the first sample on
    feed.vehicles, feed.led, feed.followers, feed.lanes = [1, 2, 3], {2, 3}, {3}, {}
    feed.now, feed.adapted = {1: (30.0, 9.0), 2: (20.0, 9.0), 3: (10.0, 9.0)}, {}
    document = Document()
    live.page(feed)(document)
    (driver,) = [s for s in document.select({"type": Select}) if s.title == "driver"]

    def after(vehicles):
        feed.now, feed.here = {v: (10.0 * v, 9.0) for v in vehicles}, set(vehicles)
        for callback in document.session_callbacks:
            callback.callback()
        return driver.value

    # who follows nobody is not chosen
    assert after([1, 2, 3]) == "vehicle 2"
    assert after([1, 3]) == "vehicle 3"
    # what the reader has chosen stays
    driver.value = "vehicle 1"
    assert after([3]) == "vehicle 1"


def test_the_live_page_circles_drivers_who_let_others_pass_and_offers_effects_that_come_with_lines():
    feed = feed_of_a_critic({"base": 0.0})
    feed.driver, feed.learnt = ({v: Log(KEPT) for v in (1, 2)} for _ in range(2))
    feed.vehicles, feed.here, feed.now, feed.road = [1, 2], {1, 2}, {1: (30.0, 9.0), 2: (20.0, 3.0)}, Road()
    document = Document()
    live.page(feed)(document)
    (effect,) = [s for s in document.select({"type": Select}) if s.title == "effect"]
    (circles,) = [r for r in document.select({"type": GlyphRenderer}) if getattr(r.glyph, "size", None) == 24]

    def update():
        for one in document.session_callbacks:  # in no order
            one.callback()

    update()
    assert len(circles.data_source.data["x"]) == 0
    feed.yielding, feed.effects = {2}, {**feed.effects, "ignored_yield": ""}
    update()
    assert list(circles.data_source.data["x"]) == [20.0]
    assert [name for name, _ in effect.options][-1] == "ignored_yield"


def junk(host, port, content):
    """Send bytes that are no request."""
    with socket.create_connection((host, port), timeout=10) as connection, contextlib.suppress(OSError):
        connection.sendall(content)
        connection.recv(100)


def test_beyond_this_machine_the_page_asks_for_a_token(recorded, tmp_path):
    port = free_port()
    command = [SUGIYAMA, "live", recorded.parent / "sim.mcap", "--host", "127.0.0.2", "--port", port]
    command += ["-o", tmp_path / "live.mcap"]
    served = subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True)

    def ask(path, **headers):
        connection = HTTPConnection("127.0.0.2", port, timeout=10)
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        body = answer.fp.read() if answer.status == 101 else answer.read()
        connection.close()
        return answer.status, body

    def headers_of(path):
        connection = HTTPConnection("127.0.0.2", port, timeout=10)
        connection.request("GET", path)
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer.headers

    try:
        served.stderr.readline()
        path = re.search(rf"127.0.0.2:{port}(\S+)", served.stderr.readline()).group(1)
        socket_headers = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        for refused in ("/", "/?token=x", "/metadata", "/autoload.js?bokeh-autoload-element=1"):
            assert ask(refused)[0] == 403
        # the server closes the web socket at once, and sends nothing
        protocol = f"bokeh, {generate_jwt_token('a')}"
        key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": protocol}
        assert b"ACK" not in ask("/ws", **socket_headers, **key)[1]
        assert ask(path)[0] == 200
        # with the token, only under the server's own names, and from its own page
        here = f"127.0.0.2:{port}"
        for headers in (
            {"Host": f"evil.example:{port}"},
            {"Host": "127.0.0.2:80"},
            {"Origin": "http://127.0.0.2:8000"},
        ):
            assert ask(path, **headers)[0] == 403
        assert ask(path, Origin="http://[")[0] == 403
        assert ask(path, Host=here, Origin=f"http://{here}")[0] == 200
        headers = headers_of(path)
        assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        cookie = headers["Set-Cookie"]
        assert cookie.startswith(f"sugiyama_token_{port}=")
        assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
        # junk is refused, and not repeated in the log
        for nothing in (
            "/static/%00",
            "/static/js/bokeh.min.js%00",
            "/static/..%2f..%2fetc%2fpasswd",
            "/static/nothing",
        ):
            assert ask(nothing)[0] in (403, 404)
        for _ in range(50):
            ask("/" + "x" * 5000)
        junk("127.0.0.2", port, b"\xff" * 100_000)
        assert ask(path)[0] == 200
    finally:
        served.send_signal(signal.SIGINT)
        assert served.wait(60) == 0
        logged = served.stderr.read()
        served.stderr.close()
    assert len(logged) < 10 * 300


def test_the_layout_for_other_programs_names_topics_and_fields_of_a_recording(recorded):
    layout = (ROOT / "layouts" / "lichtblick.json").read_text()
    plots = json.loads(layout)
    placed = re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(plots["layout"]))
    assert sorted(placed) == sorted(plots["configById"])
    asked = re.findall(r'"value": "(/[^"]+)"', layout)
    declared = (ROOT / "msg_defs" / "msg" / "DriverArray.msg").read_text()
    fields = set(re.findall(r"^[a-z]\w+\[\] (\w+)", declared, re.MULTILINE))
    with Bag(recorded) as bag:
        topics = {topic.name for topic in bag.info().topics}
        latest = {name: message for name, _, _, message in bag.messages(topics)}
    shown = Counter()
    for path in asked:
        topic, field, place = re.fullmatch(r"(/\w+(?:/\w+)?)[./](\w+)(?:\[([\d:]+)\])?", path).groups()
        if topic == "/drivers":  # in bags of `run --array`
            assert field in fields
            continue
        if topic not in topics:  # the recording has six of the vehicles
            assert re.match(r"/vehicle_\d\d/", topic)
            continue
        value = np.array(getattr(latest[topic], field))
        if place in ("2", "3"):
            assert latest[topic].name[int(place)] == {"2": "v_star", "3": "kappa_v"}[place]
        assert np.isfinite(value).all()
        shown[topic.split("/")[1]] += 1
    assert [shown[f"vehicle_{v:02d}"] for v in range(6)] == [5] * 6
    assert {"/markers", "/verdict", "/diagnostics"} <= topics


@pytest.mark.parametrize(("text", "words"), [("{", "is no JSON"), ("[]", "is no diagnosis"), ("{}", "is no diagnosis")])
def test_a_file_that_is_no_diagnosis_is_one_clear_line(tmp_path: Path, text, words):
    (tmp_path / "d.json").write_text(text)
    with pytest.raises(InputError, match=words):
        read_diagnosis(tmp_path / "d.json")
