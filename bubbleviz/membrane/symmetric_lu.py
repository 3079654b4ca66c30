"""Sparse factorisation of symmetric matrices."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu


def symmetric_lu(
    matrix: sparse.csc_array[np.float64],  # (n, n) sparse
    # of elimination, as in `splu`; "NATURAL" where the rows have one that is good
    order: Literal["NATURAL", "MMD_AT_PLUS_A"] = "MMD_AT_PLUS_A",
) -> SuperLU:
    """Factorise a symmetric matrix that needs no pivoting, as a positive definite one.

    Takes a fraction of the time of `splu` as it is, whose order (COLAMD) knows no symmetry.

    Raises RuntimeError: the matrix is singular.
    """
    return splu(
        matrix,
        permc_spec=order,
        diag_pivot_thresh=0.0,  # no pivoting: keeps the symmetric order
        relax=1,  # a mesh fills little: supernodes made larger by zeros cost more than they save
        panel_size=1,
        options={"SymmetricMode": True},
    )
