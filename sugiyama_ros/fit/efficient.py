"""Efficient scores of one driver: what a direction changes after the driver's own parameters have responded."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.effects.control import is_contaminated
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import PointwiseDensity
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.slopes import Column, density_slope


class EfficientDriver:
    """The samples of one driver, with the response of the driver's own parameters."""

    def __init__(self, data: Recorded, fitted: JointFit, i: int, blocks: Ints) -> None:
        self.number, model, self.own = i, fitted.model, len(fitted.model.individual)
        self._columns = fitted.slopes[i].columns
        self._row, self._at = model.rows[i], fitted.samples.of(i)
        self._scored = np.isfinite(self._at.log_likelihood)
        self._block = np.searchsorted(blocks, data.block[i][self._scored])
        self._count = len(blocks)
        has = np.concatenate([np.ones(self.own, np.bool_), model.has[i]])
        self._slope, self._roots = self._derivatives(self._columns)
        self._slope[~has] = 0.0
        self._roots[~has] = 0.0
        h = self._roots.reshape(len(has), -1) @ self._roots.reshape(len(has), -1).T
        prior = np.diag(np.array(model.prior_std) ** -2.0)
        own = self.own
        self._inverse = np.linalg.inv(h[:own, :own] + prior)
        self._takes = self._inverse @ h[:own, own:]
        self.shared = h[own:, own:] - h[own:, :own] @ self._takes
        # the prior counts evenly in all blocks
        g = self.over_blocks(self._slope, is_scored=True)
        away = model.away[i] / np.array(model.prior_std) / max(self._count, 1)
        self._own_score = g[:, :own] - away
        self.score_of_shared = g[:, own:] - self._own_score @ self._takes

    def _derivatives(self, columns: Sequence[Column]) -> tuple[Array, Array]:
        """Slopes of the log-likelihood (K, T'), and roots of the information (K, 2, T') of samples that count."""
        dy, dvar, direct = (self._stacked(columns, part) for part in range(3))
        y, var, _ = self._at
        slope = (density_slope(y, var, dy, dvar, self._row) + direct)[:, self._scored]
        if is_contaminated(self._row):
            return slope, np.stack([slope, np.zeros_like(slope)], axis=1)
        var = var[self._scored]
        by_mean, by_var = dy[:, self._scored] / np.sqrt(var), dvar[:, self._scored] / (np.sqrt(2.0) * var)
        return slope, np.stack([by_mean, by_var], axis=1)

    def _stacked(self, columns: Sequence[Column], part: int) -> Array:
        """One part of columns, (K, T)."""
        return np.array([c[part] for c in columns], np.float64).reshape(len(columns), len(self._scored))

    def over_blocks(self, values: Array, *, is_scored: bool = False) -> Array:
        """Sum values (K, T) of samples that count over the blocks: (B, K)."""
        kept = values if is_scored else values[:, self._scored]
        return np.array([np.bincount(self._block, row, self._count) for row in kept]).reshape(len(kept), -1).T

    def efficient(self, columns: Sequence[Column]) -> tuple[Array, Array, Array]:
        """Score (B, K) and information (B, K, K) of each block, and information (S, K) shared with the parameters S."""
        slope, roots = self._derivatives(columns)
        count, own = len(columns), self.own
        known, new = (r.reshape(len(r), -1) for r in (self._roots, roots))
        cross = known @ new.T
        takes = self._inverse @ cross[:own]
        by_shared = cross[own:] - self._takes.T @ cross[:own]
        # what is left of each direction, sample by sample
        left = roots - np.einsum("ok,ojt->kjt", takes, self._roots[:own])
        products = np.einsum("ajt,bjt->abt", left, left).reshape(count * count, -1)
        information = self.over_blocks(products, is_scored=True).reshape(self._count, count, count)
        return self.over_blocks(slope, is_scored=True) - self._own_score @ takes, information, by_shared

    def response(self, at: PointwiseDensity, row: Array) -> Array:
        """Change of the coordinates of the driver's own parameters (I,) at a start, to first order."""
        y, var, density = at.of(self.number)
        dy, dvar = (self._stacked(self._columns[: self.own], part) for part in range(2))
        slope = density_slope(y, var, dy, dvar, row)[:, np.isfinite(density) & self._scored].sum(axis=1)
        return np.asarray(self._inverse @ slope)
