"""The way in which imports run, as README's architecture section tells it."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "sugiyama_ros"
#: Every room may import those above it, and errors.
ORDER = (
    "arrays",
    "entry_points",
    "jit",
    "progress",
    "plugins",
    "picture",
    "results",
    "plots",
    "tables",
    "road",
    "trajectories",
    "formats",
    "driver",
    "laws",
    "effects",
    "simulation",
    "filters",
    "workers",
    "fit",
    "diagnosis",
    "calibration",
    "studies",
    "page",
    "api",
    "nodes",
    "cli",
    "compile",
)
#: Single files that no reader needs to know about.
SMALL = {"entry_points", "progress", "plugins", "picture", "results", "plots", "tables"}
#: Rooms that know nothing of drivers, whatever the order allows.
ALONE = {
    "page": {"arrays", "formats", "plots", "progress", "results", "road", "tables", "trajectories"},
    "__init__": {"api", "effects", "laws"},
}
ROS = {"rclpy", "rcl_interfaces", "sugiyama_msgs", "std_srvs", "diagnostic_msgs", "visualization_msgs", "rosgraph_msgs"}
FILES = sorted(PACKAGE.rglob("*.py"))


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    here = room(path)
    rooms = {name.split(".")[1] for name in imported(path) if name.startswith("sugiyama_ros.")}
    allowed = ALONE[here] if here in ALONE else set(ORDER[: ORDER.index(here)]) if here in ORDER else set()
    assert rooms - {here, "errors"} <= allowed


@pytest.mark.parametrize("path", [p for p in FILES if room(p) != "nodes"], ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_nodes_import_ros(path: Path) -> None:
    assert not {name.split(".")[0] for name in imported(path)} & ROS


def test_readme_names_every_room() -> None:
    readme = (PACKAGE.parent / "README.md").read_text()
    section = readme.split("## Architecture")[1].split("## ")[0]
    assert all(name in section for name in ORDER if name not in SMALL)
