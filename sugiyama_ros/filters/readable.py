"""The same engine with filterpy's predict and update: slow, to be read, and the reference of the compiled step."""

import numpy as np
from filterpy.kalman import predict, update

from sugiyama_ros.filters.kalman import OnlineKalman
from sugiyama_ros.filters.online_kernel import TAKEN, finish, go_on, prepare, teach, weigh
from sugiyama_ros.filters.state import STATE


class ReadableKalman(OnlineKalman):
    """An `OnlineKalman` whose state is predicted and updated by filterpy."""

    def _step(self) -> None:
        """Carry out the step in the memory, as ``online_kernel.step``."""
        if self.arrays.book.settled[0] > 0:
            go_on(self.memory)
            self._predict()
        prepare(self.memory)
        for m in np.flatnonzero(self.arrays.book.part == TAKEN).tolist():
            weigh(self.memory, m)
            self._update(m)
            teach(self.memory, m)
        finish(self.memory)

    def _predict(self) -> None:
        """Take the next mean, which is no F x, and F P F' + Q."""
        out = self.arrays.step.out
        _, self.P[:] = predict(self.x, self.P, out.jacobian, out.noise)
        self.x[:] = self.next_mean

    def _update(self, m: int) -> None:
        """Take in the position of vehicle m. With outliers the update is a mixture of two, and shrinks P otherwise."""
        y, factor, weight, shrink, _ = self.arrays.scratch.weighed.tolist()
        gain, x = self.arrays.scratch.gain, STATE * m
        measures = np.zeros((1, len(self.x)))
        measures[0, x] = factor
        noise_var = 1.0 / weight - factor * gain[x]
        self.x[:], covariance = update(self.x, self.P, measures @ self.x + y, noise_var, measures)
        self.P[:] = covariance - (shrink - weight) * np.outer(gain, gain)
