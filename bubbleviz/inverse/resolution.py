"""Resolution of the contact pressure (width of the response to a point load), and L1 threshold."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np


def resolution_m(lambda_si: float, tension_n_per_m: float, information_per_m4: float) -> float:
    """Width ℓ (standard deviation) of the estimate's response to a point load, m.

    A pressure wave of wave number k moves the membrane by p/(γ0 k²), which the camera weighs with
    w/(γ0 k²)² against the prior's λ k². The response is 1 / (1 + (k/k_c)⁶), k_c⁶ = w/(λ γ0²); the
    Gaussian of equal peak has ℓ = √(3√3/π) / k_c.

    Parameters
    ----------
    lambda_si : float
        Weight of the prior ½ λ ∫|∇p_c|², 1/Pa².
    tension_n_per_m : float
        γ0.
    information_per_m4 : float
        w: sum of 1/σ² of the range pixels per area of membrane.
    """
    cutoff = (information_per_m4 / (lambda_si * tension_n_per_m**2)) ** (1.0 / 6.0)
    return sqrt(3.0 * sqrt(3.0) / pi) / cutoff


MESH_BLUR = 0.5
"""ℓ of the blur by a mesh, in its edges."""


def at_noise(resolution_m: float, factor: float) -> float:
    """Width ℓ for noise larger by a factor, m: w decreases with its square."""
    return resolution_m * factor ** (1.0 / 3.0)


# Detection threshold: the weight of the L1 term.


SAMPLE = 200
"""Number of nodes, spread over the membrane, of which the most precisely observed is taken."""


def universal_threshold(sigma: np.ndarray, n: int) -> float:
    """Gradient per area that noise alone exceeds at none of n nodes: √(2 ln n) σ.

    The factor is the universal threshold of Donoho and Johnstone (1994) for n values. The
    penalty per newton is the same everywhere, that of the most precisely observed node, so that
    parts that the camera does not see attract no pressure.

    Parameters
    ----------
    sigma : (s,) array
        Standard deviation of the gradient per area due to noise, at nodes spread over the
        membrane.
    n : int
    """
    return float(np.sqrt(2.0 * np.log(n)) * np.max(sigma))
