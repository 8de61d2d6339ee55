"""A comparison of models as a document (for ``--json``)."""

from dataclasses import asdict
from typing import Any

from sugiyama_ros.diagnosis.compare import Compared, Comparison
from sugiyama_ros.fit.vicinity import Vicinity


def document(comparison: Comparison) -> dict[str, Any]:
    """Return all results of a comparison in plain types, in SI units.

    Parameters
    ----------
    comparison : Comparison
        The models.

    Returns
    -------
    dict
        ``headline``, ``models``, ``measured``, ``wave_speed_se``, ``decision_period_s``, ``drivers_left_out`` and
        ``seed``.
    """
    return {
        "headline": comparison.headline(),
        "models": [_model(one, comparison.vicinity) for one in comparison.models],
        "measured": asdict(comparison.measured) if comparison.measured is not None else None,
        "wave_speed_se": comparison.wave_speed_se,
        "decision_period_s": comparison.vicinity.period_s,
        "drivers_left_out": comparison.left_out,
        "seed": comparison.seed,
    }


def _model(one: Compared, vicinity: Vicinity) -> dict[str, Any]:
    return {
        "name": one.name,
        "kind": one.kind,
        **one.errors.summary(),
        **one.errors.details(),
        "collective": {name: {"mean": mean, "std": std} for name, (mean, std) in one.collective.items()},
        "drivers": [
            {**name.document(), "log_likelihood": log_likelihood, "single_car_10s_m": error}
            for name, (log_likelihood, error) in zip(vicinity.names, one.errors.by_driver(), strict=True)
        ],
        "heldout_gain_nats": one.gain.nats if one.gain else 0.0 if one.name == "base" else None,
        "heldout_gain_se": one.gain.se if one.gain else None,
        "nis_mean": one.nis_mean,
        "nis_std_error": one.nis_std_error,
        "autocorrelation": one.autocorrelation,
        "autocorrelation_band": one.band,
    }
