"""Blocks of code in pages: which are run, which are files, and which are not run, and why.

A comment directly before a block says what is special about it:

``<!-- not run: needs a robot -->``
    The block is not run. The reason is for readers of the source.
``<!-- file: NAME -->``
    The block is the content of this file, which later blocks use. ``+NAME``: it comes after what the file has.
``<!-- until: TEXT -->``
    The block goes on until Ctrl-C, which comes as soon as it has printed this text.

Blocks of the languages ``sh``, ``console`` and ``python``, blocks without a language, and the cells of notebooks are
run. In a block of the language ``console``, commands begin with ``$``, and the other lines are what the command prints.
"""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHELL, PYTHON = ("", "sh", "bash", "console"), ("python", "{code-cell} ipython3")
_BLOCK = re.compile(
    r"^(?:<!-- (?P<mark>not run|file|until): (?P<words>.+?) -->\n)?"
    r"(?P<fence>`{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"[-+±]?\d[\d,.]*(?:e[-+]?\d+)?")
_FRAME = re.compile(r"[\u2500-\u257f]")


@dataclass(frozen=True)
class Block:
    """A block of a page.

    Parameters
    ----------
    page : str
        Path of the page.
    line : int
        Line of the page on which the block begins.
    language : str
        What the page says about the language.
    mark : str
        "not run", "file", "until" or nothing.
    words : str
        What the comment says: a reason, a name or a text.
    text : str
        The block itself.
    """

    page: str
    line: int
    language: str
    mark: str
    words: str
    text: str

    @property
    def where(self) -> str:
        """Place of the block, for messages."""
        return f"{self.page}:{self.line}"

    @property
    def is_run(self) -> bool:
        """Whether the block is run."""
        return self.language in SHELL + PYTHON and self.mark not in ("not run", "file")

    @property
    def commands(self) -> list[tuple[str, str]]:
        """Commands for the shell, and what the page says that they print; nothing where it says nothing."""
        if self.language != "console":
            return [(self.text, "")]
        commands: list[tuple[str, str]] = []
        for line in self.text.splitlines(keepends=True):
            if line.startswith("$ "):
                commands.append((line[2:], ""))
            else:
                command, shown = commands.pop()
                commands.append((command, shown + line))
        return commands


def blocks(page: Path) -> list[Block]:
    """All blocks of a page, in their order."""
    text, name = page.read_text(), str(page.relative_to(ROOT))
    return [
        Block(
            name,
            text.count("\n", 0, found.start("fence")) + 1,
            found["language"].strip(),
            found["mark"] or "",
            found["words"] or "",
            found["text"],
        )
        for found in _BLOCK.finditer(text)
    ]


def pages() -> list[Path]:
    """All pages that are written by hand."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/howto/*.md"), *ROOT.glob("examples/*.md")]
    return sorted(path for path in found if path.name not in ("CHANGELOG.md", "licences.md"))


def shape(text: str) -> list[str]:
    """Lines of an output without frames, with each number as #: what stays when only the numbers change."""
    bare = (_NUMBER.sub("#", _FRAME.sub(" ", line)) for line in text.splitlines())
    return [joined for line in bare if (joined := " ".join(line.split()))]


def has_shape(printed: str, shown: str) -> bool:
    """Whether an output has the lines that a page shows, in their order. A line ``...`` stands for any lines."""
    wanted = "".join("(?:.*\n)*?" if line == "..." else re.escape(line) + "\n" for line in shape(shown))
    return re.fullmatch(wanted, "".join(line + "\n" for line in shape(printed))) is not None
