"""A model from a file on another recording.

What a file says of the road and of all drivers holds for other people, too. What it says of one person does not: other
people are draws of a population, and their own parameters are fitted to the recording, as those of the base model are.
What the file says of a moment of its own recording holds nowhere else.
"""

from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from sugiyama_ros.effects.registry import ROW, strengths
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.joint import LARGEST_STD, JointFit, fit_base
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.model_file import ModelFile, decisions_between
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.laws.registry import PAPERS, name_of, number_of
from sugiyama_ros.trajectories.tracks import Tracks


class Given(NamedTuple):
    """How a model from a file was used on another recording.

    fitted: Names of the parameters of each driver that were fitted to the recording; left_out: Effects that are tied to
    a moment of the file's own recording; decision_period_s: Time [s] from one decision to the next in the file; None if
    the file does not say it.
    """

    fitted: tuple[str, ...]
    left_out: tuple[str, ...]
    decision_period_s: float | None


def check_given(file: ModelFile) -> None:
    """Raise InputError for a model file of drivers by several laws: other people are draws of one population."""
    laws = [name_of(number) for number in np.unique(file.rows[:, ROW.law]).tolist()]
    if len(laws) > 1:
        raise InputError(f"model: its drivers drive by several laws, {', '.join(laws)}; give a file of one law")


def prepare_for(recording: Tracks, file: ModelFile) -> Recorded | None:
    """Prepare a recording for drivers who decide as often as those of a model file; None if it does not say how often.

    Raises InputError.
    """
    period_s = file.conditions.decision_period_s
    if period_s is None:
        return None
    data = prepare(recording)
    if data.every > data.decisions:
        return data
    decisions = decisions_between(data.apart_s, period_s)
    return data if decisions == data.decisions else prepare(recording, decisions)


def fit_people(data: Recorded, base: JointFit, file: ModelFile, work: Executor) -> tuple[JointFit, Given]:
    """Fit a model from a file to the people of another recording, from the fit of the base model to it."""
    left_out, names = file.of_a_moment, file.conditions.individual
    places = [ROW.entries.index(name) for name in names] or list(base.model.individual)
    row = file.other
    for name in file.effects:
        has, switches = file.has(name), strengths(name)
        if name not in left_out and not has.all():
            # whom of the others the effect acts on is not known, so it is sought in each of them
            places += switches
            row[switches] = np.median(file.rows[has][:, switches], axis=0)
    tied = [k for name in left_out for k in range(ROW.width)[ROW.places[name]]]
    own = tuple(k for k in dict.fromkeys((*data.even.individual(), *places)) if k not in tied)
    rows = np.tile(row, (data.drivers, 1))
    if file.rows[0, ROW.law] == number_of(PAPERS):
        known = [k for k in own if k in base.model.individual]
        rows[:, known] = base.model.rows[:, known]
    start = Model(rows, own, (), (LARGEST_STD,) * len(own), rows.copy())
    fitted = fit_base(data, own, work, start)
    return fitted, Given(tuple(ROW.entries[k] for k in own), left_out, file.conditions.decision_period_s)
