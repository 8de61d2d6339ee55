"""The base model of a diagnosis: with the paper's noises of position and speed, or with those of the drivers at hand.

The paper keeps both noises at constants that suit its recording. Where vehicles move more evenly, the constants leave
the driver model nothing to explain: the noise of the acceleration goes to 0, and the innovations are too small.
"""

from concurrent.futures import Executor
from dataclasses import replace

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.screen import QUICK, screen
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, index
from sugiyama_ros.fit.cross_validation import Gain, gain
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.smooth_positions import FREED

# Standard errors by which another base model must be better: a missing effect makes it a little better, too.
_CLEAR = 5.0
# A first look at other noises, the same for all drivers, that gains less than this [nats] promises nothing.
_PROMISE = 20.0
_OTHER_NOISES = Candidate(
    name="noises",
    kind="constants",
    places=tuple(map(index, FREED)),
    starts=({},),
    individual=False,
    summary="noises of position and speed are fitted",
    is_noise=True,
)


def is_clear(won: Gain, parameters: int = 0) -> bool:
    """Return whether a base model is so much better than another one that no missing effect is the reason.

    Parameters
    ----------
    won : Gain
        Gain of its fit over the fit of the other one.
    parameters : int
        Number of parameters that it has more. Each gains about one nat that held-out samples do not confirm.
    """
    return won.nats - parameters > _CLEAR * won.se


def base_model(data: Recorded, work: Executor) -> tuple[Recorded, JointFit]:
    """Fit the base model, and fit the noises of position and speed as well if that is clearly better.

    Parameters
    ----------
    data : Recorded
        The recording.
    work : Executor
        Runs the filters.

    Returns
    -------
    data : Recorded
        The recording; it says which noises are fitted.
    base : JointFit
        The fitted base model.
    """
    base = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
    if data.even.frees_noises:
        return data, base
    look = screen(data, base, _OTHER_NOISES, work, QUICK)
    if look.gain < _PROMISE:
        return data, base
    freed = replace(data, even=data.even._replace(has_other_noises=True))
    again = fit_base(freed, freed.even.individual(V_STAR, KAPPA_V), work)
    won, more = gain(data, again.samples, base.samples), len(FREED) * data.drivers
    return (freed, again) if is_clear(won, more) else (data, base)
