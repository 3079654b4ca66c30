"""A flat plate to press with."""

import numpy as np

from bubbleviz.rigid_object import RigidObject


def plate(half=0.2, thickness=0.01):
    x = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners = np.vstack([np.c_[x, np.zeros(4)], np.c_[x, np.full(4, thickness)]])
    sides = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    for i in range(4):
        j = (i + 1) % 4
        sides += [[i, j, j + 4], [i, j + 4, i + 4]]
    return RigidObject("plate", corners, np.array(sides))
