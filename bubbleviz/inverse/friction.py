"""Friction of contacts, as far as a frame shows it, as nuisances of the contact pressure.

A depth image does not show friction, but friction moves the membrane: without it, the estimate
would explain that motion by pressure where nothing touches. By depth alone a contact has three
unknowns: slides along two directions across its mean normal, and a spin about it. Each is a
traction proportional to the contact pressure, so that its amplitude is the share of Coulomb's
friction that acts. Optical flow shows more: where it sees a contact, every node has a tangential
traction, as smooth as the contact pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from bubbleviz.inverse.response import LinearisedRubber, Tangent
from bubbleviz.membrane import connected_parts, dense_part

FRICTION = 1.0
"""Largest standard deviation of the amplitudes: dry latex on common materials has coefficients of
friction between 0.5 and 1.5. On rubber dragged and twisted by another solver, half and twice this
value change the force by 0.2 % in the median and at most 2.4 % at 1 % depth noise."""

_MIN_LOAD_SHARE = 0.25
"""Share of the largest contact's load from which a contact has its own amplitudes. In the loading
phase of the real press, amplitudes of single nodes with a tenth of the load fitted errors of the
model, and the solution alternated between two supports."""

_MIN_FLOW_SHARE = 0.5
"""Least share of a contact's nodes with flow measured next to them, for tractions at its nodes: if
the texture of a contact is mostly hidden, depth alone is used. Chosen."""

_MOST_NODES = 300
"""Most nodes of a contact with tractions at its nodes, as for optimising the support: with two
unknowns per node, time grows with the cube of their number. Chosen."""


_SCALES = np.geomspace(0.01, 1.0, 81)
"""Scales of a prior, of slides, spins or errors beside missing returns. The smallest, which means
none, is as likely as all others together, which are equally likely: a contact has no friction, or
any share of Coulomb's. This extra weight was chosen on rubber dragged and twisted by another
solver. Intervals do not use it: otherwise friction as small as its noise would be outside in one of
three cases."""
INITIAL_SCALES = 1.0, 1.0, float(_SCALES[0])
"""Scales with which a frame begins, of slides, spins and errors beside missing returns. The latter
begin as negligible: a contact that is seen only beside missing returns is still found."""


@dataclass(frozen=True)
class PriorScale:
    """Scale of the prior of some amplitudes, such as slides, by the evidence of one frame.

    Attributes
    ----------
    value : float
        The scale whose number of determined parameters (MacKay 1992) is the mean over all scales,
        so that its solution is near their mean.
    axes : (q, q) array
        Directions in which the amplitudes are independent.
    solutions, precision : (scales, q) array
        Amplitudes along them and their precision, for each scale.
    evidence : (scales,) array
        Its logarithm.
    chosen : int
        Number of the scale `value`.
    """

    value: float
    axes: np.ndarray
    solutions: np.ndarray
    precision: np.ndarray
    evidence: np.ndarray
    chosen: int

    @property
    def spread(self) -> np.ndarray:
        """What the uncertainty of the scale adds to the covariance of the amplitudes, (q, q)."""
        equal, variance = _normalised(self.evidence), 1.0 / self.precision
        deviations = self.solutions - self.solutions[self.chosen]
        more = np.maximum(equal @ variance - variance[self.chosen], 0.0)
        spread = np.diag(more) + (deviations.T * equal) @ deviations
        return np.asarray(self.axes @ spread @ self.axes.T)


def prior_scale(
    amplitudes: np.ndarray, covariance: np.ndarray, sigma: float, present: float
) -> PriorScale:
    """Scale of the prior of slides, spins, or errors beside missing returns, by depth alone.

    A wide prior alone would take noise for friction: at 1 % of depth noise, the force of presses
    without friction into rubber of another solver is off by up to 2.6 %, instead of 1.2 %.

    Parameters
    ----------
    amplitudes, covariance : (q,), (q, q) array
        Amplitudes in the solution of a frame, as slides of all contacts, and their covariance.
    sigma : float
        Their standard deviation at scale 1.
    present : float
        Scale with which the frame was solved.
    """
    information = np.linalg.inv(covariance)
    prior = (sigma * _SCALES) ** -2.0
    data, axes = np.linalg.eigh(information - (sigma * present) ** -2.0 * np.eye(len(amplitudes)))
    data, pulled = np.maximum(data, 0.0), axes.T @ (information @ amplitudes)
    precision = data + prior[:, None]
    solutions, determined = pulled / precision, (data / precision).sum(axis=1)
    evidence = 0.5 * (solutions @ pulled - np.log1p(data / prior[:, None]).sum(axis=1))
    likely = evidence.copy()
    likely[0] += np.log(len(_SCALES) - 1.0)
    chosen = int(np.argmin(np.abs(determined - _normalised(likely) @ determined)))
    return PriorScale(float(_SCALES[chosen]), axes, solutions, precision, evidence, chosen)


def _normalised(log_weight: np.ndarray) -> np.ndarray:
    """Weights whose sum is 1, from their logarithms."""
    weight = np.exp(log_weight - log_weight.max())
    normalised: np.ndarray = weight / weight.sum()
    return normalised


def friction_nuisances(
    tangent: Tangent,
    pressure: np.ndarray,
    rings: np.ndarray,
    smoothness: sparse.csr_array,
    seen: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Motions and forces (n, 3, m) of friction, of contacts by depth alone and of those with flow.

    Parameters
    ----------
    tangent : Tangent
    pressure : (n,) array
        p_c, Pa; connected nodes under pressure are a contact.
    rings : (d, n) int array
        As of `MembraneMesh`.
    smoothness : (n, n) sparse array
        λ L, the prior of the pressure; times 1/σ², it is that of a tangential traction.
    seen : (n,) bool array
        Nodes next to which flow was measured.
    """
    by_flow = contacts_seen_by_flow(pressure, rings, seen)
    depth = flow = (np.zeros((len(pressure), 3, 0)),) * 2
    if (by_flow != (pressure > 0.0)).any():
        loads = friction_loads(tangent.x, tangent.area_vectors, pressure, rings, ~by_flow)
        depth = tangent.motion(loads), loads
    if by_flow.any():
        flow = _tractions(tangent, np.flatnonzero(by_flow), smoothness)
    return [depth, flow]


def contacts_seen_by_flow(pressure: np.ndarray, rings: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Nodes (n,) bool of the contacts under a pressure (n,) that flow, at nodes `seen`, determines.

    Contacts with too many nodes for a traction at each are excluded.
    """
    touching = pressure > 0.0
    if not seen.any():  # as in every frame without colour
        return seen
    count, contact = connected_parts(rings, touching)
    nodes, size = np.flatnonzero(touching), np.bincount(contact, minlength=count)
    enough = np.bincount(contact, seen[nodes], count) >= _MIN_FLOW_SHARE * size
    touching[nodes] = (enough & (size <= _MOST_NODES))[contact]
    return touching


def friction_loads(
    x: np.ndarray,
    area_vectors: np.ndarray,
    pressure: np.ndarray,
    rings: np.ndarray,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """Two slides and a spin of each contact: forces for a unit of each, (n, 3, 3 contacts), N.

    Contacts that are small beside the largest have no amplitudes.

    Parameters
    ----------
    x : (n, 3) array
        Shape, m.
    area_vectors : (n, 3) array
        Of its nodes, m².
    pressure : (n,) array
        p_c, Pa; connected nodes under pressure are a contact.
    rings : (d, n) int array
        As of `MembraneMesh`.
    among : (n,) bool array, optional
        Nodes whose contacts have amplitudes; all by default.
    """
    touching = pressure > 0.0
    count, contact = connected_parts(rings, touching)
    nodes = np.flatnonzero(touching)
    load = pressure[nodes] * np.linalg.norm(area_vectors[nodes], axis=1)
    loads = np.bincount(contact, load, minlength=count)
    large = np.flatnonzero(loads >= _MIN_LOAD_SHARE * loads.max())
    if among is not None:
        large = large[np.isin(large, contact[among[nodes]])]
    forces = np.zeros((len(x), 3, 3 * len(large)))
    for k, number in enumerate(large):
        own = nodes[contact == number]
        every = contact_friction(x[own], area_vectors[own], pressure[own])
        forces[own, :, 3 * k : 3 * k + 3] = every[..., :3]
    return forces


def _tractions(
    tangent: Tangent, nodes: np.ndarray, smoothness: sparse.csr_array
) -> tuple[np.ndarray, np.ndarray]:
    """Tangential tractions of nodes (c,), as 2c amplitudes that are independent in their prior."""
    assert isinstance(tangent, LinearisedRubber)  # of the other material, friction is 0
    root = np.linalg.cholesky(dense_part(smoothness, nodes))
    independent = solve_triangular(root, np.eye(len(nodes)), lower=True).T
    spread = np.kron(independent, np.eye(2))
    shape = (*tangent.x.shape, spread.shape[1])
    motions = (tangent.tangential_responses(nodes) @ spread).reshape(shape)
    forces = np.zeros(shape)
    across = tangent.tangents[nodes].swapaxes(1, 2)
    forces[nodes] = np.einsum("cij,cja->cia", across, spread.reshape(len(nodes), 2, -1))
    return motions, forces


def contact_friction(x: np.ndarray, area_vectors: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """Forces of friction of one contact for a unit of each amplitude, (c, 3, 4), N.

    Two slides across its mean normal, a spin about it, and a spread away from it, which a membrane
    has that sticks to the object while the contact grows: the first three are those that the
    depth image of a frame determines. Each is a traction of about the contact pressure.

    Parameters
    ----------
    x : (c, 3) array
        Its nodes, m.
    area_vectors : (c, 3) array
        Of these nodes, m².
    pressure : (c,) array
        p_c > 0, Pa.
    """
    area = np.linalg.norm(area_vectors, axis=1, keepdims=True)
    load, normal = pressure * area[:, 0], area_vectors / area
    axis = load @ normal
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    spin = np.cross(axis, x - load @ x / load.sum())
    radius = np.sqrt(load @ (spin**2).sum(axis=1) / load.sum())  # 0 of a single node
    spin /= max(radius, np.finfo(float).tiny)
    slides = np.stack([first, np.cross(axis, first)], axis=1)
    turned = np.stack([spin, np.cross(spin, axis)], axis=2)
    along = np.concatenate([np.broadcast_to(slides, (len(x), 3, 2)), turned], axis=2)
    along = along - normal[:, :, None] * np.einsum("ci,cij->cj", normal, along)[:, None]
    return load[:, None, None] * along
