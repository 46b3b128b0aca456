"""All ways in which columns and rows of a photo may be those of a table."""

from itertools import product

import numpy as np

#: Turns and mirror images of a square lattice.
TURNS = tuple(
    np.array(one)
    for one in product(((1, 0), (-1, 0), (0, 1), (0, -1)), repeat=2)
    if abs(one[0][0] * one[1][1] - one[0][1] * one[1][0]) == 1
)
