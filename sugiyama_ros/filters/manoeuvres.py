"""Which manoeuvre a driver makes, online: three models of the movement across the road, mixed (IMM).

A vehicle that keeps its lane hardly moves across the road. One that changes moves at about a lane's width in
``CHANGE_S``. An interacting-multiple-model estimator weighs the three models by each measured position across the road.
How likely a manoeuvre begins comes from the Boltzmann rule, so that the traffic around speaks before the car moves.

References
----------
Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33 (1988) 780.
"""

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.lane_change import CHANGE_S, KEEP, MANOEUVRES, TO_LANE
from sugiyama_ros.errors import InputError

# Time [s] in which the lateral speed becomes that of the manoeuvre, and std [m/s] of the lateral speed around it.
_SETTLES_S, _WEAVES = 1.0, 0.15
# Least probability in a second that a manoeuvre begins: drivers may change lanes for reasons that nobody sees.
_LEAST = 1e-3


class ManoeuvreFilter:
    """Probabilities that a driver keeps their lane, or changes to the left or to the right.

    Parameters
    ----------
    period_s : float
        Time [s] between two samples.
    noise_std : float
        Std [m] of the measurement noise across the road.
    width_m : float
        Width [m] of a lane.

    Raises
    ------
    InputError
        For a setting that is not positive.

    Examples
    --------
    A car that moves to the left by 0.8 m in a second:

    >>> import numpy as np
    >>> one = ManoeuvreFilter(0.25, noise_std=0.05)
    >>> for d_m in [0.0, 0.0, 0.0, 0.2, 0.4, 0.6, 0.8]:
    ...     probability = one.step(d_m, np.array([0.98, 0.01, 0.01]))
    >>> one.manoeuvre
    'left'
    """

    def __init__(self, period_s: float, noise_std: float, width_m: float = 3.5) -> None:
        for name, value in (("period_s", period_s), ("noise_std", noise_std), ("width_m", width_m)):
            if not value > 0.0:
                raise InputError(f"manoeuvres: {name} = {value:g} must be positive")
        self._period_s = period_s
        filters = [_model(way * width_m / CHANGE_S, period_s, noise_std) for way in TO_LANE]
        self._imm = IMMEstimator(filters, np.array([1.0, 0.0, 0.0]), self._transitions(np.array([1.0, 0.0, 0.0])))
        self._is_first = True
        #: Probabilities of keep, left and right, shape (3,).
        self.probability: Array = np.array([1.0, 0.0, 0.0])

    @property
    def manoeuvre(self) -> str:
        """The likeliest manoeuvre."""
        return MANOEUVRES[int(np.argmax(self.probability))]

    def step(self, d_m: float, chosen: Array) -> Array:
        """Take a sample.

        Parameters
        ----------
        d_m : float
            Measured position [m] across the road, growing to the left.
        chosen : ndarray, shape (3,)
            Probabilities of what the driver decides from this sample to the next, as of `choose`.

        Returns
        -------
        ndarray, shape (3,)
            Probabilities of keep, left and right, given all samples so far.
        """
        imm = self._imm
        if self._is_first:
            for one in imm.filters:
                one.x = np.array([[d_m], [0.0]])
            self._is_first = False
        else:
            imm.predict(np.ones((1, 1)))
        # the estimator mixes for the next prediction at the end of its update
        imm.M = self._transitions(chosen)
        imm.update(np.array([[d_m]]))
        self.probability = np.asarray(imm.mu, dtype=np.float64).copy()
        return self.probability

    def _transitions(self, chosen: Array) -> Array:
        """Return the probabilities (3, 3) of going over from the manoeuvre of the row to that of the column."""
        least, ends = _LEAST * self._period_s, self._period_s / CHANGE_S
        begins = np.clip(chosen, least, None)
        stays = np.array([[0.0, 0.0, 0.0], [ends, 1.0 - ends - least, least], [ends, least, 1.0 - ends - least]])
        stays[KEEP] = begins / begins.sum()
        return stays


def _model(lateral_speed: float, period_s: float, noise_std: float) -> KalmanFilter:
    """Make the filter of a manoeuvre: position [m] across the road, and lateral speed [m/s], which settles."""
    left = float(np.exp(-period_s / _SETTLES_S))
    one = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    one.F = np.array([[1.0, period_s], [0.0, left]])
    one.B = np.array([[0.0], [(1.0 - left) * lateral_speed]])
    one.H = np.array([[1.0, 0.0]])
    one.R = np.array([[noise_std * noise_std]])
    # the speed has the stationary std _WEAVES
    variance = _WEAVES * _WEAVES * (1.0 - left * left)
    one.Q = variance * np.array([[period_s * period_s / 4.0, period_s / 2.0], [period_s / 2.0, 1.0]])
    one.P = np.diag([noise_std * noise_std, _WEAVES * _WEAVES])
    return one
