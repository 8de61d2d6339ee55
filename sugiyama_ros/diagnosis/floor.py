"""The floor: errors of a model on a recording that the model has simulated itself."""

from concurrent.futures import Executor

from sugiyama_ros.diagnosis.bootstrap import resampled_fit, seeds
from sugiyama_ros.diagnosis.errors import HeldOutErrors, held_out_errors
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import filtered_states

# Steps of the fit to the simulated recording, which starts at the truth.
_FEW_STEPS = 3


def floor_of(data: Recorded, fitted: JointFit, seed: int, work: Executor) -> HeldOutErrors:
    """Return the held-out errors of a model on a recording that it simulates, after a short fit to this recording.

    What is left then is noise. No model can be expected to do better on the measured recording.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model.
    seed : int
        Seed of the noises.
    work : Executor
        Runs the filters.

    Returns
    -------
    HeldOutErrors
        Errors on the simulated recording.
    """
    states = filtered_states(data, fitted.model, work)
    simulated, again = resampled_fit(data, fitted, states, seeds(seed, 1)[0], work, _FEW_STEPS)
    return held_out_errors(simulated, again, work, searched=False)
