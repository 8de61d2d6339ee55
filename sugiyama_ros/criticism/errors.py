"""How far a model is off, on samples that it has not been fitted to."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.criticism.fitting import Model, Recorded, Samples, of_folds
from sugiyama_ros.criticism.free_run import HORIZONS_S, FreeRuns, follow, free_runs, rmse

#: Share by which a free run's error may be larger than before without counting as worse: two starts differ by more.
TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class Errors:
    """Held-out samples and free runs of a model, each predicted by the model fitted without its fold."""

    samples: Samples
    runs: FreeRuns

    @property
    def loglik_per_sample(self) -> float:
        """Natural logarithm, per car and sample, without the 2 pi term."""
        return self.samples.total / max(int(np.isfinite(self.samples.log_likelihood).sum()), 1)

    @property
    def one_step_rmse_m(self) -> float:
        """Of the innovations [m]."""
        return rmse(self.samples.innovation_m)

    def by_driver(self) -> list[tuple[float, float]]:
        """Log-likelihood [nats] and single-car 10-s error [m] of every driver."""
        totals = np.nansum(self.samples.log_likelihood, axis=1)
        return [(float(total), rmse(self.runs.single[:, -1, i])) for i, total in enumerate(totals)]

    def no_worse_than(self, other: "Errors") -> bool:
        """Whether no free run's error is larger by more than TOLERANCE, at any horizon."""
        ours, theirs = self.summary(), other.summary()
        names = [name for name in ours if name.startswith(("free_run", "single_car"))]
        return all(not ours[name] > (1.0 + TOLERANCE) * theirs[name] for name in names)

    def summary(self) -> dict[str, float]:
        """All figures by name."""
        coupled, single = (
            [rmse(e[:, k]) for k in range(len(HORIZONS_S))] for e in (self.runs.coupled, self.runs.single)
        )
        return {
            "one_step_rmse_m": self.one_step_rmse_m,
            **{f"free_run_{h:g}s_m": e for h, e in zip(HORIZONS_S, coupled, strict=True)},
            **{f"single_car_{h:g}s_m": e for h, e in zip(HORIZONS_S, single, strict=True)},
            "loglik_per_sample": self.loglik_per_sample,
        }


def errors_of(data: Recorded, models: Sequence[Model], work: Executor) -> Errors:
    """Errors of the models fitted without each fold, from ``fitting.without_folds``."""
    followed = [follow(data, model, work) for model in models]
    samples = of_folds(data, [samples for samples, _ in followed])
    return Errors(samples, free_runs(data, models, [states for _, states in followed], work))
