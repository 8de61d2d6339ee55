"""What a study is: a question, a way to answer it, and an answer as a table and a figure."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Names of columns, and rows of values.
Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Asked:
    """What a study may use: measured trajectories if there are any, a number of runs, a seed, and workers."""

    trajectories: Trajectories | None
    runs: int
    seed: int
    work: Executor

    @property
    def measured(self) -> Trajectories:
        """The trajectories. Raises InputError where none were given."""
        if self.trajectories is None:
            raise InputError("study: asks for measured drivers; give a FILE of trajectories")
        return self.trajectories


@dataclass(frozen=True, eq=False)
class Answer:
    """Rows of a table, and what draws the figure into matplotlib's Figure."""

    rows: tuple[Row, ...]
    draw: Callable[[Any], None]


@dataclass(frozen=True, eq=False)
class Study:
    """A question of the paper, what the paper says about it, and how it is answered here."""

    name: str
    question: str
    paper: str
    answer: Callable[[Asked], Answer]
