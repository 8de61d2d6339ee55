"""The shape of the package: imports run one way, class names are unique, files and functions stay short."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "sugiyama_ros"
#: The rooms (folders and single files), as in README. Each room may import the rooms above it, and errors.
ORDER = (
    "arrays",
    "inputs",
    "interrupts",
    "outputs",
    "documents",
    "entry_points",
    "progress",
    "fingerprint",
    "jit",
    "by_address",
    "plugins",
    "picture",
    "results",
    "plots",
    "tables",
    "road",
    "trajectories",
    "formats",
    "bridges",
    "driver",
    "laws",
    "effects",
    "simulation",
    "filters",
    "drives",
    "workers",
    "fit",
    "diagnosis",
    "criticism",
    "calibration",
    "studies",
    "page",
    "api",
    "nodes",
    "cli",
    "compile",
)
#: Single files that README does not have to name.
SMALL = {"entry_points", "inputs", "interrupts", "progress", "plugins", "picture", "results", "plots", "tables"}
#: Rooms that may import only these rooms, whatever the order allows.
ALONE = {
    "page": set(
        ["arrays", "documents", "formats", "outputs", "plots", "progress", "results", "road", "tables", "trajectories"]
    ),
    "__init__": {"api", "effects", "laws"},
}
ROS = {"rclpy", "rcl_interfaces", "sugiyama_msgs", "std_srvs", "diagnostic_msgs", "visualization_msgs", "rosgraph_msgs"}
FILES = sorted(PACKAGE.rglob("*.py"))
LINES_OF_A_FILE = 600
#: Lines and arguments of a function, and of a compiled kernel.
LIMITS, LIMITS_OF_KERNELS = (60, 8), (100, 10)


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


def test_class_names_are_unique() -> None:
    places = defaultdict(list)
    # criticism/ takes over the names of diagnosis/, which it will replace
    for path in (path for path in FILES if path.parent.name != "diagnosis"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def size_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> tuple[int, int]:
    """Lines from ``def`` to the end, and arguments without ``self`` and ``cls``."""
    assert function.end_lineno is not None
    a = function.args
    names = [one.arg for one in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return function.end_lineno - function.lineno + 1, len(names) - (names[:1] in (["self"], ["cls"]))


def is_kernel(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a decorator is ``kernel`` or ``kernel(...)``."""
    names = (one.func if isinstance(one, ast.Call) else one for one in function.decorator_list)
    return any(isinstance(name, ast.Name) and name.id == "kernel" for name in names)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_files_and_functions_are_short(path: Path) -> None:
    text = path.read_text()
    length = len(text.splitlines())
    assert length <= LINES_OF_A_FILE
    for function in functions(ast.parse(text)):
        lines, arguments = size_of(function)
        most_lines, most_arguments = LIMITS_OF_KERNELS if is_kernel(function) else LIMITS
        assert lines <= most_lines, f"{function.name} has {lines} lines"
        assert arguments <= most_arguments, f"{function.name} has {arguments} arguments"
