"""A filter that starts a driver anew on a ring, behind a leader who goes on."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.chain import Chain

_RING_M = 230.0


@pytest.mark.parametrize("turns", [0, 1, 3])
def test_a_driver_starts_anew_behind_a_leader_who_has_driven_rounds(turns):
    """Both drive at 8 m/s, 12 m apart, and the leader has just passed the seam of the ring."""
    period_s, speed, samples = 1.0 / 3.0, 8.0, 120 + turns * 86
    time = period_s * np.arange(samples)
    own, leader = speed * time, speed * time + 12.0
    identity = np.tile(np.array([0, 1]), (samples, 1))
    # the driver is another one from here on, just before the seam; the leader is behind the seam already
    anew = int(np.argmax(own > _RING_M * (turns + 1) - 6.0))
    identity[anew:, 0] = 2
    chain = Chain(
        position_m=np.mod(np.column_stack((own, leader)), _RING_M),
        identity=identity,
        length_m=np.full((samples, 2), 4.0),
        around=np.full((samples, 11), np.nan),
        period_s=period_s,
        start_s=0.0,
        circumference_m=_RING_M,
    )
    found = filter_chain(chain, defaults())
    headway = found.mean[anew + 1 :, 4] - found.mean[anew + 1 :, 0]
    # without noise in the positions, the filter stays within a fraction of the model's noises of 0.3 m
    np.testing.assert_allclose(headway, 12.0, atol=1.0)
