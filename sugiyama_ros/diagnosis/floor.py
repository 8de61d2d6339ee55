"""The floor: errors of a model on recordings that the model has simulated itself."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.diagnosis.errors import HeldOutErrors


def floor_of(errors: Sequence[HeldOutErrors]) -> dict[str, float]:
    """Put together the held-out errors of a model on recordings that it simulates.

    What is left then is noise. No model can be expected to do better on the measured recording.

    Parameters
    ----------
    errors : sequence of HeldOutErrors
        Errors on each simulated recording, after a short fit to it.

    Returns
    -------
    dict of str to float
        Errors by name, as ``HeldOutErrors.summary``: lengths [m] as the root of the mean square over the recordings,
        and the mean log-likelihood.
    """
    each = [one.summary() for one in errors]
    return {
        name: float(np.sqrt(np.mean(np.square(found))) if name.endswith("_m") else np.mean(found))
        for name, found in {name: [one[name] for one in each] for name in each[0]}.items()
    }
