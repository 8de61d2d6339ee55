"""Slopes at a model near a fitted one: the derivatives of the fitted model, and new ones from difference quotients."""

from collections.abc import Mapping, Sequence

from sugiyama_ros.arrays import Array
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity
from sugiyama_ros.fit.slopes import Column, Slopes, column, sums


def joined(
    data: Recorded, base: JointFit, model: Model, at: PointwiseDensity, new: Mapping[int, Sequence[Column]]
) -> tuple[Slopes, ...]:
    """Slopes at a model near ``base``: derivatives of ``base``, and ``new`` derivatives by the other parameters."""
    known, places = [*base.model.individual, *base.model.shared], (*model.individual, *model.shared)
    found = []
    for i, (s, row) in enumerate(zip(base.slopes, model.rows, strict=True)):
        columns = [s.columns[known.index(k)] if k in known else new[k][i] for k in places]
        found.append(sums(at.of(i), columns, row, data.fold[i]))
    return tuple(found)


def differences(at: PointwiseDensity, there: PointwiseDensity, step: float, rows: Array) -> list[Column]:
    """Difference quotients of every driver's samples; rows: (N, WIDTH)."""
    return [column(at.of(i), there.of(i), step, row) for i, row in enumerate(rows)]
