"""Pages that are written when the documentation is built: the reference, from declarations, and the notebooks.

Commands come from the Typer app, messages from msg_defs, parameters from their declarations and from config, the Python
interface from ``sugiyama_ros.__all__``. Notebooks are copied from examples, because Sphinx reads only what is in docs.
"""

import ast
import inspect
import re
from collections.abc import Iterable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.config import Config
from typer.main import get_command

import sugiyama_ros as sg
from sugiyama_ros.cli.app import app as commands_app
from sugiyama_ros.diagnosis.check import Check
from sugiyama_ros.diagnosis.where import Bin
from sugiyama_ros.driver.bicycle import CAR
from sugiyama_ros.driver.parameters import PARAMETERS, Parameter
from sugiyama_ros.formats.registry import formats
from sugiyama_ros.page.document import Addition, Dropped, Tried
from sugiyama_ros.studies.registry import STUDIES

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
GENERATED = DOCS / "generated"
#: Default values that say nothing to a user.
_EMPTY = (None, False, "", (), [])


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""

    def line(cells: Sequence[object]) -> str:
        return "| " + " | ".join(re.sub(r"\s+", " ", str(cell)).replace("|", r"\|") for cell in cells) + " |"

    return "\n".join((line(headings), "|" + "---|" * len(headings), *(line(row) for row in rows))) + "\n"


def code(text: str) -> str:
    """Text in the style of code, or nothing."""
    return f"`{text}`" if text else ""


def plain(text: str) -> str:
    """Text in which Markdown sees no markup."""
    return re.sub(r"([*_^<>\[\]])", r"\\\1", text)


def default_of(parameter: Any) -> str:
    """Default value of an argument or an option, if it says something to a user."""
    if parameter.required:
        return "required"
    return "" if callable(parameter.default) or parameter.default in _EMPTY else code(str(parameter.default))


def commands() -> str:
    """Every command with its arguments and options."""
    group: Any = get_command(commands_app)
    parts = [
        "# Commands\n",
        "`sugiyama COMMAND --help` prints the same text. Every command that prints a result takes `--json`, and then"
        " prints one JSON document. Results go to the standard output, everything else to the standard error. A mistake"
        " that you can correct ends a command with one line and the exit code 2.\n",
    ]
    for name, command in group.commands.items():
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        usage = " ".join(p.name.upper() if p.required else f"[{p.name.upper()}]" for p in arguments)
        parts.append(f"## {name}\n\n```\nsugiyama {f'{name} {usage}'.strip()} [OPTIONS]\n```\n")
        parts.append(plain(inspect.cleandoc(command.help or "")) + "\n")
        rows = [
            (
                code(", ".join(p.opts) if p.param_type_name == "option" else p.name.upper()),
                plain(p.help or ""),
                default_of(p),
            )
            for p in command.params
            if p.name != "help"
        ]
        parts.append(table(("argument or option", "meaning", "default"), rows))
    return "\n".join(parts)


def messages() -> str:
    """Every message and service with its fields."""
    parts = ["# Messages and services\n", "All of them are in the package `sugiyama_msgs`. Units are SI.\n"]
    for path in (*sorted(ROOT.glob("msg_defs/msg/*.msg")), *sorted(ROOT.glob("msg_defs/srv/*.srv"))):
        lines = path.read_text().splitlines()
        about = [line.lstrip("# ") for line in lines if line.startswith("#")]
        parts.append(f"## {path.stem}\n\n{plain(' '.join(about))}\n")
        rows: list[tuple[str, str, str]] = []
        for line in lines:
            if line.startswith("---"):
                rows.append(("**response**", "", ""))
            elif line and not line.startswith("#"):
                field, _, comment = line.partition("#")
                kind, name = field.split()
                rows.append((code(name), code(kind), plain(comment.strip())))
        parts.append(table(("field", "type", "meaning"), rows))
    return "\n".join(parts)


def declared(parameters: Iterable[Parameter]) -> str:
    """A table of declared parameters."""
    rows = (
        (code(p.name), p.unit, f"{p.default:g}", f"{p.lower:g} to {p.upper:g}", plain(p.description))
        for p in parameters
    )
    return table(("parameter", "unit", "default", "range", "meaning"), rows)


def node_parameters(path: Path) -> str:
    """A table of the parameters in a node's parameter file."""
    found = re.findall(r"^ {4}(\w+): *(.*?) *# *(.*)$", path.read_text(), re.MULTILINE)
    return table(("parameter", "default", "meaning"), ((code(n), code(v), plain(text)) for n, v, text in found))


def parameters() -> str:
    """Parameters of drivers and of nodes."""
    parts = [
        "# Parameters\n",
        "## Of a driver\n",
        "Each parameter is declared once, in `sugiyama_ros/driver/parameters.py`. The optimiser, the ROS parameter"
        " descriptors, the model files, the command line and the reports read this declaration. The defaults hold for"
        " a time of 1/3 s between samples.\n",
        declared(PARAMETERS),
        "## Of a car in the plane\n",
        "They are declared in `sugiyama_ros/driver/bicycle.py`; {doc}`/bicycle` says what they mean.\n",
        declared(CAR),
        "## Of the nodes\n",
        "The package installs these parameter files, one for each node.\n",
    ]
    for path in sorted((ROOT / "config").glob("*.yaml")):
        parts.append(f"### {path.stem}\n\n{node_parameters(path)}")
    return "\n".join(parts)


def extensions(title: str, about: str, found: Iterable[Any]) -> str:
    """Every effect, or every law, with its parameters."""
    parts = [f"# {title}\n", about + "\n"]
    for one in found:
        parts.append(f"## {one.name}\n\n{plain(one.title or one.name)}: {plain(one.summary)}\n")
        stage = getattr(one, "stage", "")
        parts.append((f"Stage: {stage}. " if stage else "") + f"Source: {plain(one.source)}.\n")
        parts.append(declared(one.parameters) if one.parameters else "It has no parameters.\n")
    return "\n".join(parts)


def studies() -> str:
    """Every study, with its question and what the paper says."""
    rows = ((code(one.name), plain(one.question), plain(one.paper)) for one in STUDIES.values())
    about = "`sugiyama study NAME` answers one question. {doc}`/studies` has the answers."
    return f"# Studies\n\n{about}\n\n" + table(("study", "question", "the paper"), rows)


def file_formats() -> str:
    """Every file format, in the order in which they are tried."""
    rows = ((code(one.name), code(" ".join(one.suffixes)), plain(one.summary)) for one in formats())
    about = "A file has the first format that recognises it. {doc}`/howto/data` says what else you may have to know."
    return f"# File formats\n\n{about}\n\n" + table(("format", "files", "content"), rows)


def python() -> str:
    """The public Python interface."""
    functions = [name for name in sg.__all__ if inspect.isfunction(getattr(sg, name))]
    results = {}
    for name in functions:
        kind = inspect.signature(getattr(sg, name)).return_annotation
        if inspect.isclass(kind) and kind.__module__.startswith("sugiyama_ros"):
            results[f"{kind.__module__}.{kind.__qualname__}"] = kind
    lines = [
        "Python",
        "======",
        "",
        "With ``import sugiyama_ros as sg``. Importing the package changes neither the environment nor any file, and",
        "loads neither numba nor rclpy. ``sg.laws``, ``sg.effects`` and ``sg.controllers`` map names to declarations;",
        "``sg.__version__`` is the version.",
        "",
        ".. currentmodule:: sugiyama_ros",
        "",
        ".. autosummary::",
        "",
        *(f"   {name}" for name in functions),
        "",
        "Functions",
        "---------",
        "",
        *(f".. autofunction:: {name}\n" for name in functions),
        "Results",
        "-------",
        "",
        "Every result has these methods, and shows itself in a notebook.",
        "",
        ".. currentmodule:: sugiyama_ros.results",
        "",
        ".. autoclass:: Result",
        "   :members: summary, to_frame, plot, save",
        "",
        *(f".. autoclass:: {name}\n" for name in results),
        ".. automethod:: sugiyama_ros.verdict.compare.Comparison.to_xarray",
        "",
        "Document of a diagnosis",
        "-----------------------",
        "",
        "``sugiyama diagnose --json`` prints it, ``--save`` keeps it.",
        "",
        ".. autofunction:: sugiyama_ros.page.document.document",
        "",
        *(f".. autoclass:: {one.__module__}.{one.__qualname__}\n" for one in (Addition, Dropped, Tried, Check, Bin)),
        ".. autofunction:: sugiyama_ros.diagnosis.table.errors",
        "",
    ]
    return "\n".join(lines)


def numbers() -> str:
    """Every number by which a diagnosis decides, with the comment above it."""
    rows = []
    for path in sorted(ROOT.glob("sugiyama_ros/diagnosis/*.py")):
        lines = path.read_text().splitlines()
        for node in ast.parse("\n".join(lines)).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = ", ".join(ast.unparse(target) for target in targets).strip("()")
                comment = list(takewhile(lambda line: line.startswith("#"), reversed(lines[: node.lineno - 1])))
                if names.isupper() and comment and any(c.isdigit() for c in ast.unparse(node.value)):
                    text = " ".join(line.lstrip("#: ") for line in reversed(comment))
                    parts = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                    value = "; ".join(ast.unparse(part) for part in parts)
                    rows.append((code(names.lower().replace("_", " ").strip()), code(value), plain(text), path.name))
    about = "All numbers by which `sugiyama diagnose` decides, as they stand in `sugiyama_ros/diagnosis`."
    return f"# Numbers of a diagnosis\n\n{about} {{doc}}`/verdict` says what for.\n\n" + table(
        ("number", "value", "meaning", "file"), rows
    )


def write(name: str, text: str) -> None:
    """Write a page if it has changed, so that Sphinx reads only what is new."""
    path = GENERATED / name
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def pages(app: Sphinx, config: Config) -> None:
    """Write all pages."""
    GENERATED.mkdir(exist_ok=True)
    write("commands.md", commands())
    write("messages.md", messages())
    write("parameters.md", parameters())
    about = "Every law is one file in `sugiyama_ros/laws`. {doc}`/howto/law` says how to add one of your own."
    write("laws.md", extensions("Laws", about, sg.laws.values()))
    about = "Every controller is one file in `sugiyama_ros/controllers`. {doc}`/controlled` has the equations."
    write("controllers.md", extensions("Controllers", about, sg.controllers.values()))
    write("studies.md", studies())
    write("numbers.md", numbers())
    write("formats.md", file_formats())
    write("python.rst", python())
    for notebook in (ROOT / "examples").glob("*.md"):
        # a link that holds in examples has one folder too many here
        write(notebook.name, notebook.read_text().replace("](../docs/", "](../"))


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for files."""
    app.connect("config-inited", pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
