"""Results of the pipeline for one frame."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from bubbleviz.recordings import Frame, Texture

if TYPE_CHECKING:
    from bubbleviz.camera import FlowField, ImageErrors
    from bubbleviz.diagnostics import Inspection
    from bubbleviz.membrane import MembraneMesh

Status = Literal["ok", "no_contact", "no_data", "not_converged", "implausible"]
"""`implausible`: the sensor's membrane cannot look like the depth image under the measured gas
pressure, given the calibrated noise. `not_converged`: the solver failed, or the change of pressure
is too large for the linear gas law."""

TRUSTED: tuple[Status, ...] = ("ok", "no_contact")
"""Statuses of frames with trustworthy numbers."""

HALF_95 = 1.96
"""Half of the 95 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class FineContact:
    """Contact of an estimate on a locally refined mesh, see `inverse.contact_refiner`."""

    mesh: MembraneMesh  # the part of the reference surface around the contact, k nodes
    # (k, 2) or (k, 4) int, nodes of the full mesh whose mean each node is; all the same for its own
    ends: np.ndarray
    edge_m: float  # mean length of the mesh's edges at the contact
    contact_pressure_pa: np.ndarray  # (k,), p_c, Pa
    motion_m: np.ndarray  # (k, 3), displacement, m
    resolution_m: float  # as in `Estimate`

    def estimate(self, coarse: Estimate) -> Estimate:
        """The coarse estimate with its fields replaced by those on the fine mesh."""
        return replace(
            coarse,
            displacement_m=np.einsum("ij,ij->i", self.motion_m, self.mesh.normals),
            contact_pressure_pa=self.contact_pressure_pa,
            averaged_pressure_pa=None,
            displacement_3d_m=self.motion_m,
            resolution_m=self.resolution_m,
            fine=None,
        )

    def on_whole(self, level: np.ndarray, nodes: int) -> np.ndarray:
        """A level (k,) at the nodes of the full mesh, (nodes,); its minimum where unknown."""
        full = np.full(nodes, level.min())
        shared = (self.ends == self.ends[:, :1]).all(axis=1)
        full[self.ends[shared, 0]] = level[shared]
        return full


@dataclass(frozen=True)
class FlowFit:
    """How well the optical flow of a contact is fitted.

    Attributes
    ----------
    rms_px : float
        Measured minus modelled motion in the image.
    noise : float
        Residual over its noise, by which its weight is reduced.
    displacement_sigma_m : float
        rms over the contact of the standard deviation of a node's displacement, per axis.
    """

    rms_px: float
    noise: float
    displacement_sigma_m: float


@dataclass(frozen=True, repr=False)
class Estimate:
    """Solution of the inverse problem for one frame (Eq. 23).

    Attributes
    ----------
    status : Status
        Only numbers with a status of `TRUSTED` are trustworthy.
    displacement_m : (n,) array
        u along the reference normals, m.
    contact_pressure_pa : (n,) array
        p_c ≥ 0, Pa.
    gas_pressure_change_pa : float
        p_v, Pa. If gas pressure was recorded, estimated from measurement and shape together; the
        paper's solver takes the measurement unchanged.
    residual_rms_m : float
        Root mean square of measured minus modelled range over the pixels used, m.
    kkt_residual : float
        Relative KKT residual of the problem the solver was given.
    iterations : int
        Iterations (or pivots) of the solver.
    solve_ms : float
        Wall time of the solver alone, ms.
    displacement_3d_m : (n, 3) array or None
        Full displacement vector, m.
    nodal_force_n : (n, 3) array or None
        Force of the contact on the nodes, N: p_c on the deformed area vectors (linear membrane:
        those at rest), and friction.
    friction_n : (n, 3) array or None
        Its part by friction, N; 0 for the linear membrane, None for the paper's solver.
    force_n : (3,) array or None
        The sum of `nodal_force_n`, N.
    wrench_covariance : (6, 6) array or None
        Of that force, N, and its torque about the origin of B, N·m, by noise, friction, material
        and model error, not by the place of a moved camera; None for the paper's solver.
    gas_law_pa : float or None
        p_v by the gas law for the shape, Pa.
    resolution_m : float or None
        Width of the response to a point load at the noise assumed by the solver, m; None for the
        paper's solver.
    noise_factor : float
        Noise of the image over that of the sensor file; it includes errors of the model.
    reason : str
        Why the numbers are not trustworthy, in one clause; empty if they are.
    averaged_pressure_pa : (n,) array or None
        Mean of p_c over the set of nodes in contact and those that differ from it by one node,
        weighted by their evidence, Pa: the patch's edge follows it. None for the paper's solver,
        and on a finer mesh.
    fine : FineContact or None
        The contact on a finer mesh; None where the mesh is as fine as the noise allows.
    seen_share : float
        Share of the contact's area that the camera sees; NaN without contact, and for the paper's
        solver. The rest of the force is inferred from the membrane around it.
    image_errors : ImageErrors or None
        Errors of the entire depth image since calibration; None if not known.
    flow : FlowFit or None
        None where no optical flow of a contact was used.
    flow_contradicts : bool
        Whether it was not used as it contradicts the depth image.
    caveat : str
        How wrong the force may be due to the model of the membrane, in one clause, or empty.
    """

    status: Status
    displacement_m: np.ndarray
    contact_pressure_pa: np.ndarray
    gas_pressure_change_pa: float
    residual_rms_m: float
    kkt_residual: float
    iterations: int = 0
    solve_ms: float = 0.0
    displacement_3d_m: np.ndarray | None = None
    nodal_force_n: np.ndarray | None = None
    friction_n: np.ndarray | None = None
    force_n: np.ndarray | None = None
    wrench_covariance: np.ndarray | None = None
    gas_law_pa: float | None = None
    resolution_m: float | None = None
    noise_factor: float = 1.0
    reason: str = ""
    averaged_pressure_pa: np.ndarray | None = None
    fine: FineContact | None = None
    seen_share: float = np.nan
    image_errors: ImageErrors | None = None
    flow: FlowFit | None = None
    flow_contradicts: bool = False
    caveat: str = ""

    @property
    def trusted(self) -> bool:
        """Whether the numbers are trustworthy."""
        return self.status in TRUSTED

    def __repr__(self) -> str:
        force = "" if self.force_n is None else f", {np.linalg.norm(self.force_n):.3g} N"
        misfit = f", misfit {1e3 * self.residual_rms_m:.2g} mm rms"
        return f"<estimate: {self.status}{force + misfit if self.trusted else ''}>"

    @property
    def status_text(self) -> str:
        """Status, and the reason if there is one."""
        return f"{self.status}: {self.reason}" if self.reason else self.status

    @property
    def force_sigma_n(self) -> np.ndarray | None:
        """Standard deviation of `force_n`, (3,), N; None for the paper's solver."""
        covariance = self.wrench_covariance
        return None if covariance is None else np.sqrt(np.diag(covariance)[:3])

    def torque_sigma_about(self, point_m: np.ndarray) -> np.ndarray:
        """Standard deviation of the torque about a point (3,) in B, (3,), N·m."""
        return np.sqrt(np.diag(self.torque_covariance_about(point_m)))

    def torque_covariance_about(self, point_m: np.ndarray) -> np.ndarray:
        """Covariance of the torque about a point (3,) in B, (3, 3); NaN for the paper's solver."""
        if self.wrench_covariance is None:
            return np.full((3, 3), np.nan)
        J = wrench_about(point_m)[3:]
        covariance: np.ndarray = J @ self.wrench_covariance @ J.T
        return covariance

    @property
    def force_half_width_n(self) -> float:
        """Half of the 95 % interval of |F|, N; NaN without contact, or for the paper's solver."""
        return float("nan") if self.force_n is None else self.half_width_along(self.force_n)

    def half_width_along(self, vector: np.ndarray) -> float:
        """Half of the 95 % interval of the force along a vector (3,), N; NaN if that is 0."""
        covariance = self.wrench_covariance
        if covariance is None or not np.linalg.norm(vector) > 0.0:
            return float("nan")
        direction = vector / np.linalg.norm(vector)
        return HALF_95 * float(np.sqrt(direction @ covariance[:3, :3] @ direction))

    @property
    def motion_m(self) -> np.ndarray:
        """Displacement for `MembraneMesh.deformed`: the full vector if known, else u."""
        return self.displacement_m if self.displacement_3d_m is None else self.displacement_3d_m


@dataclass(frozen=True, repr=False)
class Patch:
    """The contact patch: the part of the membrane in contact (V-C).

    Attributes
    ----------
    threshold_pa : float
        Contact pressure at the edge by κ, Pa. By default, where no pressure is the threshold (see
        `level`), half the gas pressure.
    level : (n,) array
        Positive inside; its zero line, interpolated linearly, is the edge of the patch. By default
        the signed distance to the edge, m.
    force_n : (3,) array
        Force of the contact on the membrane in B, N (points into the sensor).
    center_of_pressure_m : (3,) array
        Pressure-weighted centre of the patch in B, m; NaN without contact.
    area_m2 : float
        Area of the patch on the reference surface, m²; 0 without contact.
    edge_half_width_m : float
        Uncertainty of the edge, m: the band between the lines at ± this level contains most of the
        true edge (docs/how-good-it-is.md has the shares). NaN for the paper's rule.
    area_interval_m2 : (float, float)
        Areas within the inner and outer line of that band, m². If the inner one is near 0, the
        patch is hardly wider than the uncertainty of its edge.
    pixel_mask : (H, W) bool array or None
        Pixels of the patch; None when `pixel_mask` was not requested.
    kappa : float or None
        Threshold over the mean contact pressure; None: automatic rule.
    tangential_force_n : (3,) array
        The part of the force by friction, N; NaN for the linear membrane, which has none.
    torque_nm : (3,) array
        Moment of the contact about the centre of pressure, N·m; NaN without contact.
    fine_level : (k,) array or None
        The level on the mesh of the estimate's `fine` contact; None without it, and for the paper's
        rule.
    """

    threshold_pa: float
    level: np.ndarray
    force_n: np.ndarray
    center_of_pressure_m: np.ndarray
    area_m2: float
    edge_half_width_m: float = np.nan
    area_interval_m2: tuple[float, float] = (np.nan, np.nan)
    pixel_mask: np.ndarray | None = None
    kappa: float | None = None
    tangential_force_n: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    torque_nm: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    fine_level: np.ndarray | None = None

    def __repr__(self) -> str:
        force = float(np.linalg.norm(self.force_n))
        return f"<patch: {1e6 * self.area_m2:.0f} mm², {force:.3g} N>"

    def finest(
        self, mesh: MembraneMesh, estimate: Estimate
    ) -> tuple[MembraneMesh, Estimate, np.ndarray]:
        """The finest available mesh, with the estimate and the level on it."""
        if self.fine_level is None or estimate.fine is None:
            return mesh, estimate, self.level
        return estimate.fine.mesh, estimate.fine.estimate(estimate), self.fine_level

    @property
    def node_mask(self) -> np.ndarray:
        """Nodes in the patch, (n,) bool."""
        return self.level > 0.0


TractionStatus = Literal["ok", "no_contact", "depth_alone", "no_data", "not_converged"]
"""`depth_alone`: no texture of the contact is seen, or colour contradicts depth. Friction is then
known by depth alone: two slides and a spin of each contact."""


@dataclass(frozen=True)
class Traction:
    """Where the force of an estimate on the exact membrane acts, and what is known of friction."""

    status: TractionStatus
    # normal_pa, tangential_pa: (n, 3), force on the membrane over the deformed area of the node, Pa
    normal_pa: np.ndarray
    tangential_pa: np.ndarray
    # (n, 3), displacement from the reference surface minus its part along the deformed normal, m
    tangential_displacement_m: np.ndarray
    reason: str = ""  # why friction or traction is unknown, in one clause; empty if known


def wrench_about(point_m: np.ndarray) -> np.ndarray:
    """Matrix (6, 6) that takes force and torque about the origin to those about a point (3,)."""
    x, y, z = point_m
    matrix = np.eye(6)
    matrix[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]  # τ − point × F
    return matrix


@dataclass(frozen=True)
class Slip:
    """Parts of a contact patch that slip relative to the rest of it.

    Slip is displacement since contact. It is only known relative to a part that sticks: a frame has
    none of these numbers once friction has stopped growing after some slip, as all may slide then.
    """

    # (k, 3), material points inside the patch tracked by flow since they came into contact, m
    points_m: np.ndarray
    slip_m: np.ndarray  # (k, 3), their tangential motion relative to the object, m
    slipping: np.ndarray  # (k,) bool, those with slip above noise
    share: float  # of the patch's area that slips, 0 to 1
    share_sigma: float  # its standard deviation, by noise and parts that may slip unseen


PoseStatus = Literal["ok", "lost", "no_contact", "few_points", "no_data"]
"""`lost`: no pose fits this frame; the last good one, if any, is kept. Before the first pose,
`no_contact`, `few_points` (too few in the patch) and `no_data` (no trusted estimate) say why."""


@dataclass(frozen=True)
class Stage:
    """Result of one stage of the registration."""

    T_B_O: np.ndarray  # (4, 4)
    fitness: float  # share of inliers among the contact points, 0 to 1
    rmse_m: float  # root mean square distance of the inliers from the object
    correspondences: int  # number of inliers
    history: np.ndarray  # (i, 2), fitness, and rmse in m, initially and after every iteration
    ms: float  # wall time


@dataclass(frozen=True)
class Pose:
    """Pose of the object.

    The small motions of `motions` are in B about `center_m`: translation in m, then rotation in
    rad.

    Attributes
    ----------
    status : PoseStatus
    T_B_O : (4, 4) array
        NaN before the first pose.
    stage_one, stage_two : Stage or None
        Fit to the contact points alone, and refined around the patch; None if not fitted.
    center_m : (3,) array
        Centre of the patch.
    covariance : (6, 6) array
        Of the origin's position in B, m, and of a rotation vector about it in B, rad; from contact,
        the depth image around it, and earlier frames, with the other poses of a search that are
        not refuted.
    motions : (6, 6) array
        Six independent small motions in columns, best determined first; a unit of each moves the
        patch's edge by about 1 m.
    deviation_m : (6,) array
        Standard deviation of each at the patch's edge, by the contact's normals alone.
    determined : (6,) bool array
        Whether the contact's normals determine it. Not determined are the sliding of a flat face
        and the spin of a ball.
    points_m, places_m : (k, 3) array
        Contact points and the closest points on the object.
    distance_m : (k,) array
        Signed distance of the contact points from the object, positive outside.
    distance_rms_m : float
        Root mean square distance from the object, of the nearest 95 % of the contact's area.
    distance_limit_m : float
        Limit that errors of the estimate rarely exceed. Beyond it the object is another one, or in
        another pose, or narrower than the sensor resolves.
    others : (r, 4, 4) array
        Other poses of a search that fit as well, without those in which the object looks the same.
    rejected : Stage or None
        The best fit of a frame in which the object is lost.
    """

    status: PoseStatus
    T_B_O: np.ndarray
    stage_one: Stage | None = None
    stage_two: Stage | None = None
    center_m: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    covariance: np.ndarray = field(default_factory=lambda: np.full((6, 6), np.nan))
    motions: np.ndarray = field(default_factory=lambda: np.eye(6))
    deviation_m: np.ndarray = field(default_factory=lambda: np.full(6, np.inf))
    determined: np.ndarray = field(default_factory=lambda: np.zeros(6, bool))
    points_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    places_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    distance_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    distance_rms_m: float = np.nan
    distance_limit_m: float = np.nan
    others: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    rejected: Stage | None = None

    @property
    def contradicted(self) -> bool:
        """Whether the contact is farther from the object than errors of the estimate explain."""
        return self.distance_rms_m > self.distance_limit_m

    def __repr__(self) -> str:
        if self.status != "ok":
            return f"<pose: {self.status}>"
        place = ", ".join(f"{1e3 * each:.2f}" for each in self.T_B_O[:3, 3])
        left = np.count_nonzero(~self.determined)
        return f"<pose: ok, origin at {place} mm, {left} of 6 motions not determined>"


@dataclass(frozen=True)
class ObjectPatch:
    """Contact patch computed from the object's shape and pose, independent of noise of p_c."""

    level: np.ndarray  # (n,), signed distance to the edge, m, positive inside
    area_m2: float  # on the reference surface, m²


@dataclass(frozen=True, repr=False)
class Result:
    """The products of one frame; those not requested are None."""

    frame: Frame
    estimate: Estimate | None = None
    patch: Patch | None = None
    cloud_m: np.ndarray | None = None  # (k, 3), valid measured points in B, m
    cloud_pixels: np.ndarray | None = None  # (k,) int, flat pixel index of each point of the cloud
    # (k,), measured minus modelled range of each point, m (NaN where the model has no surface)
    cloud_residual_m: np.ndarray | None = None
    pose: Pose | None = None  # None also without object
    object_patch: ObjectPatch | None = None  # None also if the pose is lost
    flow: FlowField | None = None  # None also without colour image or contact-free reference
    traction: Traction | None = None
    slip: Slip | None = None  # None also if too little of the patch sticks
    texture: Texture | None = None  # None also without trusted estimate
    inspection: Inspection | None = None  # diagnostics for panels
    # wall time by stage, ms; `total` is depth in → products out
    times_ms: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        present = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        products = ", ".join(name for name in present if name not in ("frame", "times_ms"))
        status = "" if self.estimate is None else f"{self.estimate.status}; "
        return f"<result of frame {self.frame.index}: {status}{products or 'no products'}>"

    @property
    def solution(self) -> tuple[Estimate, Patch]:
        """Estimate and patch. Raises ValueError: they were not requested."""
        if self.estimate is None or self.patch is None:
            raise ValueError("the result lacks the product estimate or patch; request both")
        return self.estimate, self.patch

    @property
    def trusted_estimate(self) -> Estimate | None:
        """The estimate, if its numbers are trustworthy."""
        return self.estimate if self.estimate is not None and self.estimate.trusted else None

    @property
    def trusted_patch(self) -> Patch | None:
        """The patch, if its estimate is trustworthy."""
        return None if self.trusted_estimate is None else self.patch
