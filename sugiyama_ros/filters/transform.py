"""Products with the Jacobian F, of which only the entries that are not 0 are multiplied."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.online_state import Sparse
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def find_entries(jacobian: Array, sparse: Sparse) -> None:
    """Fill in where F is not 0."""
    size = len(jacobian)
    for i in range(size):
        count = 0
        for j in range(size):
            if jacobian[i, j] != 0.0:
                sparse.columns[i, count] = j
                count += 1
        sparse.counts[i] = count


@kernel(allocates=False)
def move(vector: Array, jacobian: Array, sparse: Sparse, moved: Array) -> None:
    """F x in place; moved: (N,), overwritten."""
    for i in range(len(vector)):
        moved[i] = 0.0
        for c in range(sparse.counts[i]):
            moved[i] += jacobian[i, sparse.columns[i, c]] * vector[sparse.columns[i, c]]
    for i in range(len(vector)):
        vector[i] = moved[i]


@kernel(allocates=False)
def transform(symmetric: Array, jacobian: Array, sparse: Sparse, half: Array) -> None:
    """F P F' in place, and exactly symmetric; half: (N, N), overwritten."""
    size = len(symmetric)
    for i in range(size):
        half[i] = 0.0
        for c in range(sparse.counts[i]):
            k = sparse.columns[i, c]
            factor = jacobian[i, k]
            for j in range(size):
                half[i, j] += factor * symmetric[k, j]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for c in range(sparse.counts[j]):
                total += half[i, sparse.columns[j, c]] * jacobian[j, sparse.columns[j, c]]
            symmetric[i, j] = symmetric[j, i] = total
