"""The shape of the package: imports run one way, class names are unique, files and functions stay short."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "sugiyama_ros"
#: The rooms (folders and single files), as in CONTRIBUTING.md. Each room may import the rooms above it, and errors.
ORDER = (
    "arguments",
    "arrays",
    "files",
    "interrupts",
    "progress",
    "fingerprint",
    "jit",
    "by_address",
    "plugins",
    "results",
    "statistics",
    "road",
    "trajectories",
    "driver",
    "roads",
    "formats",
    "bridges",
    "laws",
    "controllers",
    "effects",
    "simulation",
    "filters",
    "workers",
    "fit",
    "diagnosis",
    "verdict",
    "calibration",
    "page",
    "studies",
    "api",
    "nodes",
    "cli",
    "compile",
)
#: Single files that CONTRIBUTING.md does not have to name.
SMALL = {"interrupts", "progress", "plugins", "results"}
#: Rooms that may import only these rooms, whatever the order allows.
ALONE = {
    "page": {
        "arrays",
        "diagnosis",
        "driver",
        "effects",
        "files",
        "fit",
        "formats",
        "laws",
        "progress",
        "results",
        "statistics",
    }
    | {"road", "trajectories", "verdict"},
    "__init__": {"api", "controllers", "effects", "laws"},
}
#: Rooms whose results make words when they are shown: from these rooms, imported only then.
SHOWN_BY = {"diagnosis": {"page"}, "verdict": {"page"}}
#: Limits of a room: files besides ``__init__``, lines, and named numbers.
LIMITS_OF_ROOMS = {"diagnosis": (15, 3_000, 20)}
ROS = {"rclpy", "rcl_interfaces", "sugiyama_msgs", "std_srvs", "diagnostic_msgs", "visualization_msgs", "rosgraph_msgs"}
FILES = sorted(PACKAGE.rglob("*.py"))
LINES_OF_A_FILE = 600
#: Lines and arguments of a function, and of a compiled kernel.
LIMITS, LIMITS_OF_KERNELS = (60, 8), (100, 10)


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path, *, at_once: bool = False) -> set[str]:
    """Names that a module imports; ``at_once``: when it is imported itself."""
    names, tree = set(), ast.parse(path.read_text())
    for node in tree.body if at_once else ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_imports_run_one_way() -> None:
    for path in FILES:
        here = room(path)
        rooms = {name.split(".")[1] for name in imported(path) if name.startswith("sugiyama_ros.")}
        allowed = ALONE[here] if here in ALONE else set(ORDER[: ORDER.index(here)]) if here in ORDER else set()
        assert rooms - {here, "errors"} - SHOWN_BY.get(here, set()) <= allowed, path
        early = {name.split(".")[1] for name in imported(path, at_once=True) if name.startswith("sugiyama_ros.")}
        assert not early & SHOWN_BY.get(here, set()), path


def test_only_nodes_import_ros() -> None:
    for path in FILES:
        assert room(path) == "nodes" or not {name.split(".")[0] for name in imported(path)} & ROS, path


def test_the_architecture_section_names_every_room() -> None:
    page = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
    section = page.split("## Architecture")[1].split("## ")[0]
    assert all(name in section for name in ORDER if name not in SMALL)


def test_class_names_are_unique() -> None:
    places = defaultdict(list)
    for path in FILES:
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


def test_files_and_functions_are_short() -> None:
    for path in FILES:
        text = path.read_text()
        assert len(text.splitlines()) <= LINES_OF_A_FILE, path
        for function in functions(ast.parse(text)):
            lines, arguments = size_of(function)
            most_lines, most_arguments = LIMITS_OF_KERNELS if is_kernel(function) else LIMITS
            assert lines <= most_lines, f"{path}: {function.name} has {lines} lines"
            assert arguments <= most_arguments, f"{path}: {function.name} has {arguments} arguments"


def named_numbers(tree: ast.Module) -> Iterator[str]:
    """Names in capitals that a module gives to numbers, alone or in tuples."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
            values = (
                node.value.elts if isinstance(node.value, ast.Tuple) and len(names) > 1 else [node.value] * len(names)
            )
            for name, value in zip(names, values, strict=True):
                if name.isupper() and is_number(value):
                    yield name


def is_number(value: ast.expr) -> bool:
    """Whether an expression is a number, or a tuple of numbers."""
    if isinstance(value, ast.Tuple):
        return all(map(is_number, value.elts))
    if isinstance(value, ast.UnaryOp):
        return is_number(value.operand)
    return isinstance(value, ast.Constant) and isinstance(value.value, int | float)


def test_named_numbers_are_counted_one_by_one() -> None:
    tree = ast.parse("A = 1\n_B, _C = (1.0, 2.0), -3\nD = 'text'\ne = 4\nF: float = 5.0\nG = A\n")
    assert list(named_numbers(tree)) == ["A", "_B", "_C", "F"]


@pytest.mark.parametrize("name", LIMITS_OF_ROOMS)
def test_a_room_stays_small(name: str) -> None:
    files = [path for path in FILES if room(path) == name and path.name != "__init__.py"]
    numbers = [f"{path.name}: {one}" for path in files for one in named_numbers(ast.parse(path.read_text()))]
    lines = sum(len(path.read_text().splitlines()) for path in files)
    most_files, most_lines, most_numbers = LIMITS_OF_ROOMS[name]
    assert len(files) <= most_files
    assert lines <= most_lines
    assert len(numbers) <= most_numbers, numbers
