"""Types of arrays."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

#: Real numbers.
Array: TypeAlias = NDArray[np.float64]
#: Whole numbers: indices, counts, numbers of vehicles.
Ints: TypeAlias = NDArray[np.int64]
#: Yes or no for every entry.
Mask: TypeAlias = NDArray[np.bool_]
