# SPDX-License-Identifier: Apache-2.0
"""Types of NumPy arrays, without ``numpy.typing``: a plan would pay for its import."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Indexes = NDArray[np.intp]
    Flags = NDArray[np.bool_]
else:
    Array = Indexes = Flags = np.ndarray
