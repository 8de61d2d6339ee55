"""What `sugiyama_ros.lane_changes` does: the drivers of a calibration, and their decisions about lanes."""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.calibration.result import Calibration
from sugiyama_ros.driver.lane_change import LaneSpan
from sugiyama_ros.driver.parameters import COUNT
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.lane_change import LaneChoices, fit_lane_changes
from sugiyama_ros.simulation.multilane import MultilaneRun
from sugiyama_ros.trajectories.tracks import Tracks


@checked()
def lane_changes(
    tracks: Tracks | MultilaneRun,
    calibration: Calibration | None = None,
    spans: Mapping[int, tuple[float, float]] | None = None,
) -> LaneChoices:
    """Estimate how drivers choose among lanes, and compare with MOBIL on drivers of whom the fit knows nothing.

    Parameters
    ----------
    tracks : Tracks or MultilaneRun
        Vehicles on lanes of open roads. Lanes have whole numbers, which grow to the left. A simulated run is judged by
        its true drivers.
    calibration : Calibration, optional
        Parameters of the drivers, as of `calibrate`; drivers who are not in it, or whose desired speed is not
        identified, count as the median driver. Without it, all have the paper's parameters.
    spans : mapping of int to (float, float), optional
        Where lanes open to others, and where they end [m]; lanes of the tracks that are left out have no ends.

    Returns
    -------
    LaneChoices
        Rationality, politeness and cost of a change, with standard errors, and held-out log-losses.

    Raises
    ------
    InputError
        For tracks without numbered lanes, on a ring, or with too few changes of lane; for a calibration in which the
        desired speeds of most drivers are not identified.

    Examples
    --------
    >>> import sugiyama_ros as sg
    >>> found = sg.lane_changes(sg.simulate_lane_changes(seed=1))
    >>> [record["parameter"] for record in found.records()]
    ['lane_rationality', 'politeness', 'change_cost']
    """
    known = {int(lane): LaneSpan(*span) for lane, span in (spans or {}).items()}
    if isinstance(tracks, MultilaneRun):
        return fit_lane_changes(tracks.tracks, tracks.start.parameters, {**tracks.spans, **known})
    return fit_lane_changes(tracks, None if calibration is None else _drivers_in(tracks, calibration), known)


def _drivers_in(tracks: Tracks, calibration: Calibration) -> Array:
    """Return the parameters (V, P) of the drivers of all runs, out of a calibration. Raises InputError."""
    drivers, rows = calibration.drivers, calibration.rows[:, :COUNT]
    is_estimated = "v_star" in calibration.settings.estimated
    known: Mask = calibration.has_value("v_star") if is_estimated else np.ones(len(drivers), np.bool_)
    if 2 * known.sum() < len(known):
        raise InputError(
            f"calibration: the desired speeds of {(~known).sum()} of {len(known)} drivers are not identified; leave the"
            " calibration out, or calibrate these drivers in faster traffic"
        )
    of_vehicle = {
        (d.recording, str(d.vehicle)): row for d, row, is_known in zip(drivers, rows, known, strict=True) if is_known
    }
    median = np.median(rows[known], axis=0)
    first = tracks.start[:-1].tolist()
    names = [(tracks.recording.at(row), tracks.vehicle.at(row)) for row in first]
    return np.array([of_vehicle.get(name, of_vehicle.get(("", name[1]), median)) for name in names])
