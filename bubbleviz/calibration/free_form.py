"""Free-form reference surface: the fitted cap plus a smooth correction.

Nodes move along the line from the centre of the rim plane, so that rim nodes stay in the plane.
The correction c is the P1 field that minimises

    Σ w (measured − cast range)² + λ cᵀ Q c,   Q = (M/ℓ² + L) M⁻¹ (M/ℓ² + L)

with mass M and stiffness L of the mesh: bending energy at scales below ℓ, decay to the cap (zero)
where nothing is measured. λ is chosen by cross-validation over tiles of pixels: a smaller one fits
the camera's fixed pattern, a larger one misses part of the shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded, solveh_banded
from scipy.sparse.csgraph import reverse_cuthill_mckee

from bubbleviz.camera import DepthCamera, RayCaster
from bubbleviz.membrane import MembraneMesh, balance_gradient, cotangent_laplacian
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import robust_sigma, tukey_weights

_FOLDS = 5  # of the cross-validation; the usual number
_TRIED, _TOLERANCE = 8.0, 0.2
"""Half decades searched on either side of the λ of equal traces, and to what accuracy; chosen."""
LeftOut = Callable[[float], np.ndarray]
"""Errors (k,) float32, m, at a λ in half decades over that of equal traces."""
_RELINEARISATIONS = 4  # Gauss–Newton steps; the last ones move by micrometres


@dataclass(frozen=True)
class FreeForm:
    """A free-form surface, and the errors of its γ0 and height."""

    mesh: MembraneMesh  # the corrected surface in B
    # (H, W), measured minus predicted range of each pixel, by a fit without its tile, m; NaN: none
    left_out_m: np.ndarray
    # (2,), σ of γ0 under 1 Pa and of the apex's height by the posterior, m, for pixels that err
    # independently by the rms error in tiles left out of the fit: Bayesian intervals of a smoothing
    # spline (Wahba 1983) include the rim and hidden parts, which the prior alone determines
    sigma_m: np.ndarray


def fit_free_form(
    start: MembraneMesh,  # mesh of the fitted cap in B
    camera: DepthCamera,
    range_m: np.ndarray,  # (H, W), mean contact-free range, m; NaN: no return
    use: np.ndarray,  # (H, W) bool, pixels of the membrane to fit
    scale_m: float,  # length ℓ beyond which the correction is damped, m
    # side of the tiles of the cross-validation, pixels; several times the noise's correlation
    # length, or neighbours predict the noise of a tile that is left out
    tile_px: int,
    progress: Progress = quiet,
) -> FreeForm:
    """Correct a cap's mesh so that its modelled ranges fit the measured ones."""
    arms = start.nodes / np.linalg.norm(start.nodes, axis=1, keepdims=True)
    caster = RayCaster(camera.center, camera.directions, start.triangles)
    pixels = np.flatnonzero((use & np.isfinite(range_m)).ravel())
    prior = _prior(start, scale_m)
    # In this order of the nodes matrices are banded, and factorised in a fifth of the time.
    order = reverse_cuthill_mckee(prior.tocsr(), symmetric_mode=True)
    prior = prior[order][:, order]
    entries = prior.tocoo()
    width = int((entries.row - entries.col).max())
    fold = fold_of(pixels, use.shape[1], tile_px)
    correction, place = np.zeros(len(start.nodes)), 0.0
    left_out_image, triangle = np.full(range_m.size, np.nan), None
    for k in range(_RELINEARISATIONS):
        nodes = start.nodes + correction[:, None] * arms
        triangle = caster.first(nodes, pixels, triangle)
        hits = caster.hits_on(nodes, triangle, pixels)
        hit = np.searchsorted(pixels, hits.ray)
        D = caster.jacobian(nodes, hits, arms)[:, order]
        residual = range_m.ravel()[hits.ray] - hits.range_m
        target = residual + D @ correction[order]
        weights = tukey_weights(residual - np.median(residual), robust_sigma(residual))
        # λ at which data and prior have equal trace
        unit = float(np.sum(D.multiply(D).T @ weights) / prior.diagonal().sum())
        if k == 1:  # the first surface is the cap, the later ones differ by micrometres
            errors = left_out_errors(D, target, weights, fold[hit], prior * unit, width)
            place, left_out_rms = _best(errors, weights / weights.sum())
            left_out_image[hits.ray] = errors(place)
        weighted = D.multiply(weights[:, None]).tocsr()
        normal = weighted.T @ D + prior * (unit * _smoothing(place))
        factor = cholesky_banded(_bands(normal, width), lower=True), True
        correction[order] = cho_solve_banded(factor, weighted.T @ target)
        progress("free-form surface", (k + 1) / _RELINEARISATIONS)
    mesh = replace(start, nodes=start.nodes + correction[:, None] * arms)
    gradients = _gradients(mesh)[order]
    adjoint = cho_solve_banded(factor, gradients)
    return FreeForm(
        mesh=mesh,
        left_out_m=left_out_image.reshape(range_m.shape),
        sigma_m=left_out_rms * np.sqrt(np.sum(gradients * adjoint, axis=0)),
    )


def _gradients(mesh: MembraneMesh) -> np.ndarray:
    """Derivative of γ0 under 1 Pa (m) and of the apex's height by motion of the nodes, (n, 2).

    Motion is along the line from the centre of the rim plane.
    """
    arms = mesh.nodes / np.linalg.norm(mesh.nodes, axis=1, keepdims=True)
    apex, gradients = int(np.argmax(mesh.nodes[:, 2])), np.zeros((len(mesh.nodes), 2))
    gradients[:, 0] = balance_gradient(mesh, 1.0, arms)
    gradients[apex, 1] = arms[apex, 2]
    return gradients


def _prior(mesh: MembraneMesh, scale_m: float) -> sparse.csc_array:
    """Q = (M/ℓ² + L) M⁻¹ (M/ℓ² + L), n×n."""
    operator = sparse.diags_array(mesh.areas / scale_m**2) + cotangent_laplacian(mesh)
    return (operator @ sparse.diags_array(1.0 / mesh.areas) @ operator).tocsc()


def _bands(matrix: sparse.sparray, width: int) -> np.ndarray:
    """Diagonal and lower bands of a symmetric matrix, (width + 1, n), as scipy takes them."""
    lower = sparse.tril(matrix).tocoo()
    bands = np.zeros((width + 1, lower.shape[1]))
    bands[lower.row - lower.col, lower.col] = lower.data
    return bands


def _smoothing(place: float) -> float:
    """λ over that of equal traces."""
    return float(10.0 ** (0.5 * place))


def fold_of(pixels: np.ndarray, width: int, tile_px: int) -> np.ndarray:
    """Fold 0 … 4 of each pixel: all pixels of a tile share one; neighbouring tiles differ."""
    row, column = np.divmod(pixels, width)
    return (row // tile_px * 2 + column // tile_px) % _FOLDS


def left_out_errors(
    D: sparse.csr_array,  # (k, n)
    target: np.ndarray,  # (k,)
    weights: np.ndarray,  # (k,)
    fold: np.ndarray,  # (k,) int
    prior: sparse.csc_array,  # n×n, added to the normal matrix
    width: int,  # of the bands of both
) -> LeftOut:
    """Errors of linear least squares with the prior times λ, fitted without the fold of a row."""
    weighted = D.multiply(weights[:, None]).tocsr()
    matrix, right = weighted.T @ D, weighted.T @ target
    folds = []
    for k in range(_FOLDS):
        own = np.flatnonzero(fold == k)
        part, of_fold, target_of_fold = weighted[own], D[own], target[own]
        rest = matrix - part.T @ of_fold, right - part.T @ target_of_fold
        folds.append((own, of_fold, target_of_fold, *rest))

    def at(place: float) -> np.ndarray:
        errors = np.empty(len(target), np.float32)
        for own, of_fold, target_of_fold, rest, rest_right in folds:
            bands = _bands(rest + prior * _smoothing(place), width)
            solution = solveh_banded(bands, rest_right, lower=True)
            errors[own] = target_of_fold - of_fold @ solution
        return errors

    return at


def _best(errors: LeftOut, share: np.ndarray) -> tuple[float, float]:
    """λ with the smallest mean square error, in half decades, and that error's rms, m."""
    from scipy.optimize import minimize_scalar  # 0.1 s: not at the window's start

    found = minimize_scalar(
        lambda place: float(errors(place).astype(float) ** 2 @ share),
        bounds=(-_TRIED, _TRIED),
        options={"xatol": _TOLERANCE},
    )
    return float(found.x), float(np.sqrt(found.fun))
