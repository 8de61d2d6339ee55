"""What a study is: a question, and a way to answer it with a table and a figure."""

from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.dense import DenseTracks

#: A row of a table: values by the heading of the column.
Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Asked:
    """What a study may use.

    Parameters
    ----------
    trajectories : DenseTracks or None
        Measured drivers, if there are any.
    runs : int
        Number of simulated runs of each case.
    seed : int
        Seed of the first run; the other runs have the seeds that follow.
    work : Executor
        Workers.
    """

    trajectories: DenseTracks | None
    runs: int
    seed: int
    work: Executor

    @property
    def measured(self) -> DenseTracks:
        """The measured drivers. Raises InputError if there are none."""
        if self.trajectories is None:
            raise InputError("study: needs measured drivers; give a FILE of trajectories")
        if self.trajectories.controlled:
            raise InputError("study: a controller drives some of the vehicles; give a FILE of drivers alone")
        return self.trajectories


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of a study.

    Parameters
    ----------
    rows : tuple of mapping
        Rows of the table: values by the heading of the column.
    draw : callable
        Draws the figure into a ``matplotlib.figure.Figure``.
    """

    rows: tuple[Row, ...]
    draw: Callable[[Any], None]


@dataclass(frozen=True, eq=False)
class Study:
    """A question of the paper, and how it is answered here.

    Parameters
    ----------
    name : str
        Name in commands.
    question : str
        The question.
    paper : str
        What the paper says about the question.
    answer : callable
        ``Asked`` -> ``Answer``.
    takes : tuple of str
        What it uses of what is asked: ``source`` (the trajectories), ``runs`` and ``seed``.
    """

    name: str
    question: str
    paper: str
    answer: Callable[[Asked], Answer]
    takes: tuple[str, ...] = ("source", "runs", "seed")

    def check(self, given: Collection[str]) -> None:
        """Raise InputError for something that is given, of ``source``, ``runs`` and ``seed``, and not used."""
        for name, option in (("source", "FILE"), ("runs", "--runs"), ("seed", "--seed")):
            if name in given and name not in self.takes:
                raise InputError(f"study {self.name}: does not use {option}; leave it out")
