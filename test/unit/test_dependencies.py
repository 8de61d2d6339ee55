"""Several files list the dependencies, for pip and for rosdep. The tests check that the files agree."""

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
#: Keys of rosdep that are not python3-NAME.
KEYS = {
    "bokeh": "python3-bokeh-pip",
    "filterpy": "python3-filterpy-pip",
    "pillow": "python3-pil",
    "pyyaml": "python3-yaml",
    "rosbags": "python3-rosbags-pip",
}
#: Packages without a key in rosdep's python.yaml; docs/ros.md says to install them with pip.
WITHOUT_KEY = {"lz4", "mcap", "pyarrow", "zstandard"}
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
PINS = ("requirements.txt", "requirements-dev.txt", "requirements-docs.txt")


def declared(keyword: str) -> ast.expr:
    """Value of a keyword of setup() in setup.py."""
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "setup":
            return next(one.value for one in node.keywords if one.arg == keyword)
    raise AssertionError("setup.py calls no setup()")


def required() -> list[Requirement]:
    return [Requirement(text) for text in ast.literal_eval(declared("install_requires"))]


def extras() -> dict[str, list[Requirement]]:
    return {
        name: [Requirement(t) for t in texts] for name, texts in ast.literal_eval(declared("extras_require")).items()
    }


def pins(python: str, *files: str) -> dict[str, str]:
    """Pinned version of each package for a version of Python. Files that pin the same package agree on its version."""
    found: dict[str, str] = {}
    for file in files:
        for line in (ROOT / file).read_text().splitlines():
            if not line or line.startswith(("#", "    --hash=sha256:")):
                continue
            assert line.endswith(" \\"), f"{line}: has no checksum; run .ci/hashes.py"
            one = Requirement(line.removesuffix(" \\"))
            if one.marker is not None and not one.marker.evaluate({"python_version": python}):
                continue
            (pin,) = one.specifier
            assert pin.operator == "==", line
            assert found.setdefault(canonicalize_name(one.name), pin.version) == pin.version, line
    return found


@pytest.mark.parametrize("python", PYTHONS)
def test_every_requirement_is_pinned(python: str) -> None:
    pinned = pins(python, "requirements.txt")
    wanted = required() + extras()["notebook"] + extras()["pictures"]
    missing = {r.name for r in wanted if not r.specifier.contains(pinned.get(canonicalize_name(r.name), ""))}
    assert not missing


@pytest.mark.parametrize("python", PYTHONS)
def test_all_files_pin_alike(python: str) -> None:
    assert pins(python, *PINS)


def test_every_requirement_has_a_key_of_rosdep() -> None:
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {element.text for element in root.iter("exec_depend")}
    named = {canonicalize_name(r.name) for r in required()}
    assert {key for key in keys if key and key.startswith("python3-")} == {
        KEYS.get(name, f"python3-{name}") for name in named - WITHOUT_KEY
    }
    assert named >= WITHOUT_KEY
    text = (ROOT / "docs" / "ros.md").read_text()
    assert f" bokeh {' '.join(sorted(WITHOUT_KEY))}\n" in text


def test_the_hook_before_commits_runs_the_pinned_ruff() -> None:
    revision = re.search(r"rev: v(\S+)", (ROOT / ".pre-commit-config.yaml").read_text())
    assert revision is not None
    assert revision[1] == pins(PYTHONS[0], "requirements-dev.txt")["ruff"]


def test_the_citation_has_the_version_of_the_package() -> None:
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_licence_of_every_package_is_listed() -> None:
    """`.ci/licences.py` writes the page, and stops at a licence that does not allow what a user may want to do."""
    rows = re.findall(r"^\| ([a-z0-9-]+) \| ([^|]+) \| ([^|]+) \|", (ROOT / "docs" / "licences.md").read_text(), re.M)
    listed = {name: set(versions.split(", ")) for name, versions, _ in rows if name != "package"}
    pinned: dict[str, set[str]] = {}
    for python in PYTHONS:
        for name, version in pins(python, *PINS).items():
            pinned.setdefault(name, set()).add(version)
    assert listed == pinned, "run .venv/bin/python .ci/licences.py"
    assert all(licence.strip() for *_, licence in rows)
