"""Products with the Jacobian F, of which only the entries that may differ from 0 are multiplied."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.state import STATE, Linearised
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def move(vector: Array, linearised: Linearised, moved: Array) -> None:
    """F x in place; moved: (N,), overwritten."""
    for i in range(len(vector)):
        moved[i] = 0.0
        for c in range(linearised.counts[i]):
            k = linearised.columns[i, c]
            moved[i] += linearised.jacobian[i, k] * vector[k]
    for i in range(len(vector)):
        vector[i] = moved[i]


@kernel(allocates=False)
def transform(symmetric: Array, linearised: Linearised, half: Array) -> None:
    """F P F' in place, for the live entries of the state, and exactly symmetric; half: (N, N), overwritten."""
    jacobian, columns, counts, live = linearised.jacobian, linearised.columns, linearised.counts, linearised.live
    size = len(symmetric)
    for i in live:
        k = columns[i, 0]
        factor = jacobian[i, k]
        for j in range(size):
            half[i, j] = factor * symmetric[k, j]
        for c in range(1, counts[i]):
            k = columns[i, c]
            factor = jacobian[i, k]
            for j in range(size):
                half[i, j] += factor * symmetric[k, j]
    for a in range(len(live)):
        j = live[a]
        k, count = columns[j, 0], counts[j]
        factor = jacobian[j, k]
        if count == 1:
            for d in range(a, len(live)):
                i = live[d]
                symmetric[i, j] = symmetric[j, i] = half[i, k] * factor
            continue
        other = columns[j, 1]
        other_factor = jacobian[j, other]
        for d in range(a, len(live)):
            i = live[d]
            total = half[i, k] * factor + half[i, other] * other_factor
            for c in range(2, count):
                total += half[i, columns[j, c]] * jacobian[j, columns[j, c]]
            symmetric[i, j] = symmetric[j, i] = total


@kernel(allocates=False)
def add_noise(covariance: Array, linearised: Linearised) -> None:
    """Add the process noise, which correlates only entries of the same vehicle, for the live entries of the state."""
    for i in linearised.live:
        first = i - i % STATE
        for j in range(first, min(first + STATE, len(covariance))):
            covariance[i, j] += linearised.noise[i, j]
