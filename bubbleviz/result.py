"""Results of the pipeline for one frame."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from bubbleviz.recordings import Frame, Texture

if TYPE_CHECKING:
    from bubbleviz.diagnostics import Inspection
    from bubbleviz.membrane import MembraneMesh
    from bubbleviz.shear import FlowField

Status = Literal["ok", "no_contact", "no_data", "not_converged", "implausible"]
"""`implausible`: no membrane of this sensor, with the noise its file or calibration tells of and
the gas pressure measured, looks like the depth image. `not_converged`: beyond the solver, or beyond
the linear gas law."""

TRUSTED: tuple[Status, ...] = ("ok", "no_contact")
"""Statuses of frames whose numbers are to be trusted."""

HALF_95 = 1.96
"""Half of the 95 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class FineContact:
    """Contact of an estimate on a mesh that is finer there, see `inverse.contact_refiner`."""

    mesh: MembraneMesh  # the part of the reference surface around the contact, k nodes
    # (k, 2) int, nodes of the whole mesh that each of its nodes lies midway between; twice the same
    # for those of the whole mesh
    ends: np.ndarray
    contact_pressure_pa: np.ndarray  # (k,), p_c, Pa
    motion_m: np.ndarray  # (k, 3), displacement, m
    resolution_m: float  # as of the estimate

    def estimate(self, whole: Estimate) -> Estimate:
        """The estimate that it belongs to, on its mesh."""
        return replace(
            whole,
            displacement_m=np.einsum("ij,ij->i", self.motion_m, self.mesh.normals),
            contact_pressure_pa=self.contact_pressure_pa,
            displacement_3d_m=self.motion_m,
            resolution_m=self.resolution_m,
            fine=None,
        )

    def on_whole(self, level: np.ndarray, nodes: int) -> np.ndarray:
        """A level (k,) at the nodes of the whole mesh, (nodes,); its lowest where it is unknown."""
        whole = np.full(nodes, level.min())
        own = self.ends[:, 0] == self.ends[:, 1]
        whole[self.ends[own, 0]] = level[own]
        return whole


@dataclass(frozen=True, repr=False)
class Estimate:
    """Solution of the inverse problem for one frame (Eq. 23).

    Attributes
    ----------
    status : Status
        Only the numbers of `TRUSTED` are to be trusted.
    displacement_m : (n,) array
        u along the reference normals, m.
    contact_pressure_pa : (n,) array
        p_c ≥ 0, Pa.
    gas_pressure_change_pa : float
        p_v, Pa. Where the recording has the gas pressure it is what measurement and shape say
        together; the paper's solver takes the measurement as it is.
    residual_rms_m : float
        Root mean square of measured minus modelled range over the pixels used, m.
    kkt_residual : float
        Relative KKT residual of the problem the solver was given.
    iterations : int
        Iterations (or pivots) of the solver.
    solve_ms : float
        Wall time of the solver alone, ms.
    displacement_3d_m : (n, 3) array or None
        The whole displacement, m.
    unexplained_pressure_pa : (n,) array or None
        Pressure that is too little to be evidence of contact, Pa. It is part of the membrane's
        equilibrium but not of the contact pressure and force.
    nodal_force_n : (n, 3) array or None
        Force of the contact on the nodes, N: p_c on the current area vectors (of the linear
        membrane those at rest), and friction.
    friction_n : (n, 3) array or None
        The part of it that is friction, N; 0 of the linear membrane, None of the paper's solver.
    force_n : (3,) array or None
        The sum of `nodal_force_n`, N.
    force_sigma_n : (3,) array or None
        Standard deviation of that by noise, friction, material and the model's own error; None of
        the paper's solver.
    gas_law_pa : float or None
        p_v by the gas law for the shape, Pa.
    resolution_m : float or None
        Width of its response to a point load at the noise that it was solved with, m; None of the
        paper's solver, whose noise is the camera's.
    reason : str
        Why there is no number to trust, in one clause; empty where there is one.
    fine : FineContact or None
        The contact on a finer mesh; None where the mesh resolves what noise leaves of it.
    seen_share : float
        Share of the contact's area that the camera saw; NaN without contact, and of the paper's
        solver. Below 1 the rest of the force is a guess by the membrane around it.
    image_errors : (4,) array or None
        What the whole depth image is off by since calibration, see `bubbleviz.camera.IMAGE_ERRORS`;
        None where they were not looked for, and of the paper's solver.
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
    unexplained_pressure_pa: np.ndarray | None = None
    nodal_force_n: np.ndarray | None = None
    friction_n: np.ndarray | None = None
    force_n: np.ndarray | None = None
    force_sigma_n: np.ndarray | None = None
    gas_law_pa: float | None = None
    resolution_m: float | None = None
    reason: str = ""
    fine: FineContact | None = None
    seen_share: float = np.nan
    image_errors: np.ndarray | None = None

    @property
    def trusted(self) -> bool:
        """Whether its numbers are to be trusted."""
        return self.status in TRUSTED

    def __repr__(self) -> str:
        force = "" if self.force_n is None else f", {np.linalg.norm(self.force_n):.3g} N"
        misfit = f", misfit {1e3 * self.residual_rms_m:.2g} mm rms"
        return f"<estimate: {self.status}{force + misfit if self.trusted else ''}>"

    @property
    def force_half_width_n(self) -> float:
        """Half of the 95 % interval of |F|, N; NaN without contact, or of the paper's solver."""
        size = 0.0 if self.force_n is None else float(np.linalg.norm(self.force_n))
        if self.force_n is None or self.force_sigma_n is None or not size > 0.0:
            return float("nan")
        return HALF_95 * float(np.linalg.norm(self.force_n / size * self.force_sigma_n))

    @property
    def motion_m(self) -> np.ndarray:
        """Displacement as `MembraneMesh.deformed` takes it: the whole one where it is known."""
        return self.displacement_m if self.displacement_3d_m is None else self.displacement_3d_m


@dataclass(frozen=True, repr=False)
class Patch:
    """The contact patch: the part of the membrane that touches something (V-C).

    Attributes
    ----------
    threshold_pa : float
        Contact pressure below which no point belongs to the patch, Pa.
    level : (n,) array
        Positive inside; its zero line, interpolated linearly, is the edge of the patch. By default
        it is the signed distance to the edge, m.
    force_n : (3,) array
        Force of the contact on the membrane in B, N (points into the sensor).
    center_of_pressure_m : (3,) array
        Pressure-weighted centre of the patch in B, m; NaN without contact.
    area_m2 : float
        Area of the patch on the reference surface, m²; 0 without contact.
    edge_half_width_m : float
        How far off the edge may be, m: the band between the lines at this level and at minus this
        level holds most of a true edge; docs/how-good-it-is.md says how much. NaN under the
        paper's rule, which knows of none.
    area_interval_m2 : (float, float)
        Areas within the band's inner and outer line, m². An inner one near 0: the patch is hardly
        wider than its edge is uncertain.
    pixel_mask : (H, W) bool array or None
        Pixels of the patch; None when `pixel_mask` was not requested.
    kappa : float or None
        Threshold over the mean contact pressure; None where the rule is automatic.
    tangential_force_n : (3,) array
        The part of the force that is friction, N; NaN of the linear membrane, which knows none.
    torque_nm : (3,) array
        Moment of the contact about the centre of pressure, N·m; NaN without contact.
    fine_level : (k,) array or None
        The level on the mesh of the estimate's `fine` contact; None where there is none, or the
        rule is the paper's.
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
        """The finest mesh that it is known on, with the estimate and the level there."""
        if self.fine_level is None or estimate.fine is None:
            return mesh, estimate, self.level
        return estimate.fine.mesh, estimate.fine.estimate(estimate), self.fine_level

    @property
    def node_mask(self) -> np.ndarray:
        """Nodes in the patch, (n,) bool."""
        return self.level > 0.0


TractionStatus = Literal["ok", "no_contact", "depth_alone", "no_data", "not_converged"]
"""`depth_alone`: no texture was seen where the membrane is touched, so that nothing is known of
friction and the traction is the contact pressure of the estimate."""


@dataclass(frozen=True)
class Traction:
    """What depth and optical flow say together of a contact with friction."""

    status: TractionStatus  # the numbers of `no_data` and `not_converged` are NaN
    nodal_force_n: np.ndarray  # (n, 3), of the object on the membrane, N
    # normal_force_n, tangential_force_n: (n, 3), its parts along and across the current normals, N
    normal_force_n: np.ndarray
    tangential_force_n: np.ndarray
    traction_pa: np.ndarray  # (n, 3), the force over the current area of the node, Pa
    positions_m: np.ndarray  # (n, 3), nodes of the membrane, m
    # (n, 3), displacement from the reference surface less its part along the current normal, m
    tangential_displacement_m: np.ndarray
    center_m: np.ndarray  # (3,), centre of the contact's normal force, m; NaN without contact
    # (6, 6), of the force, N, and the torque about `center_m`, N·m, by noise, material and mesh;
    # NaN where nothing is known of friction
    wrench_covariance: np.ndarray
    # root mean square over the contact of the standard deviation of a node's displacement by noise,
    # in each direction, m
    displacement_sigma_m: float = np.nan
    flow_rms_px: float = np.nan  # measured less modelled motion in the image; NaN without flow
    # by how much more than by its own noise the flow was missed, which its weight allows for
    flow_noise: float = np.nan
    # why nothing is known of friction, or of anything, in one clause; empty where it is
    reason: str = ""

    @property
    def contact_pressure_pa(self) -> np.ndarray:
        """Traction along the current normals, (n,), Pa; 0 where nothing touches."""
        force = np.linalg.norm(self.nodal_force_n, axis=1)
        share = np.linalg.norm(self.normal_force_n, axis=1) / np.where(force > 0.0, force, 1.0)
        pressure: np.ndarray = share * np.linalg.norm(self.traction_pa, axis=1)
        return pressure

    @property
    def parts_pa(self) -> tuple[np.ndarray, np.ndarray]:
        """Traction along and across the current normals, (n, 3) each, Pa."""
        force = np.linalg.norm(self.nodal_force_n, axis=1)
        per_area = np.linalg.norm(self.traction_pa, axis=1) / np.where(force > 0.0, force, 1.0)
        return per_area[:, None] * self.normal_force_n, per_area[:, None] * self.tangential_force_n

    @property
    def force_n(self) -> np.ndarray:
        """Force of the object on the membrane in B, (3,), N."""
        total: np.ndarray = self.nodal_force_n.sum(axis=0)
        return total

    @property
    def force_sigma_n(self) -> np.ndarray:
        """Standard deviation of that, (3,), N."""
        return np.sqrt(np.diag(self.wrench_covariance)[:3])

    @property
    def torque_nm(self) -> np.ndarray:
        """Torque of the object on the membrane about `center_m` in B, (3,), N·m."""
        return self.torque_about(self.center_m)

    @property
    def torque_sigma_nm(self) -> np.ndarray:
        """Standard deviation of that, (3,), N·m."""
        return self.torque_sigma_about(self.center_m)

    def torque_about(self, point_m: np.ndarray) -> np.ndarray:
        """Torque about a point (3,) in B, (3,), N·m; 0 without contact."""
        touching = self.nodal_force_n.any(axis=1)
        arm = self.positions_m[touching] - point_m
        total: np.ndarray = np.cross(arm, self.nodal_force_n[touching]).sum(axis=0)
        return total

    def torque_sigma_about(self, point_m: np.ndarray) -> np.ndarray:
        """Standard deviation of the torque about a point (3,) in B, (3,), N·m."""
        x, y, z = self.center_m - point_m
        arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        moving = np.hstack([arm, np.eye(3)])
        return np.sqrt(np.diag(moving @ self.wrench_covariance @ moving.T))


@dataclass(frozen=True)
class Slip:
    """Parts of a contact patch that moved against the rest of it since they came into contact.

    Slip of the whole patch at once leaves no part to compare with and is not seen.
    """

    # (k, 3), material points inside the patch that optical flow followed since they came into
    # contact, m
    points_m: np.ndarray
    slip_m: np.ndarray  # (k, 3), their motion along the membrane over the object, m
    slipping: np.ndarray  # (k,) bool, those that slipped by more than noise
    share: float  # area of the points that slipped over that of all, 0 to 1
    share_sigma: float  # its standard deviation


PoseStatus = Literal["ok", "lost", "no_contact", "few_points", "no_data"]
"""`lost`: no pose fits this frame; the last good one is kept, where there was one. While there was
none yet, `no_contact`, `few_points` (the patch has fewer than a pose needs) and `no_data` (the
estimate is not to be trusted) say why."""


@dataclass(frozen=True)
class Stage:
    """How well a stage of the registration fits."""

    T_B_O: np.ndarray  # (4, 4)
    fitness: float  # share of the patch that agrees with the object, 0 to 1
    rmse_m: float  # root mean square distance of that share from the object
    correspondences: int  # number of contact points in that share
    history: np.ndarray  # (i, 2), fitness, and rmse in m, at the start and after every iteration
    ms: float  # wall time


@dataclass(frozen=True)
class Pose:
    """Where the object is.

    Small motions are in B about `center_m`: translation in m, then rotation in rad.

    Attributes
    ----------
    status : PoseStatus
    T_B_O : (4, 4) array
        NaN when there never was one.
    stage_one, stage_two : Stage or None
        Contact points alone, and refined around the patch; None where nothing was fitted.
    center_m : (3,) array
        Centre of the patch.
    covariance : (6, 6) array
        Of small motions: contact, depth image around it, and the frames before.
    motions : (6, 6) array
        Six independent small motions in columns, best determined first; a unit of each moves the
        patch's edge by about 1 m.
    deviation_m : (6,) array
        Standard deviation of each at the patch's edge, by the contact's normals alone.
    determined : (6,) bool array
        Whether the contact's normals determine it: a flat face slides, a ball spins.
    points_m, places_m : (k, 3) array
        Contact points and the closest places on the object.
    distance_m : (k,) array
        Signed distance of the contact points from the object, positive outside.
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

    @property
    def origin_covariance(self) -> np.ndarray:
        """Covariance of the object's origin and its rotation vector in B, (6, 6), m and rad."""
        x, y, z = self.T_B_O[:3, 3] - self.center_m
        moving = np.eye(6)  # of a small motion about the centre: t + ω × (origin − centre)
        moving[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        covariance: np.ndarray = moving @ self.covariance @ moving.T
        return covariance


@dataclass(frozen=True)
class ObjectPatch:
    """The contact patch by the object: what it presses at its pose, whatever noise p_c has."""

    # (n,), signed distance to the edge, m, positive inside; its zero line, interpolated linearly,
    # is the edge
    level: np.ndarray
    area_m2: float  # on the reference surface, m²


@dataclass(frozen=True, repr=False)
class Result:
    """The products of one frame; those not requested are None."""

    frame: Frame  # the frame it was made from
    estimate: Estimate | None = None
    patch: Patch | None = None
    cloud_m: np.ndarray | None = None  # (k, 3), valid measured points in B, m
    cloud_pixels: np.ndarray | None = None  # (k,) int, flat pixel index of each point of the cloud
    # (k,), measured minus modelled range of each point, m (NaN where the model has no surface)
    cloud_residual_m: np.ndarray | None = None
    pose: Pose | None = None  # None also where there is no object to look for
    object_patch: ObjectPatch | None = None  # None also where the pose is lost
    # None also where the frame has no colour image, or no contact-free one is known
    flow: FlowField | None = None
    traction: Traction | None = None
    slip: Slip | None = None  # None also where too little of the patch sticks to tell
    texture: Texture | None = None  # None also where the estimate is not to be trusted
    inspection: Inspection | None = None  # images, curves and parts for the panels
    # wall time of each stage that ran, by stage name, ms; `total` is depth in → products out.
    # `flow` runs beside the others, and is not to be added to them.
    times_ms: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        made = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        products = ", ".join(name for name in made if name not in ("frame", "times_ms"))
        said = "" if self.estimate is None else f"{self.estimate.status}; "
        return f"<result of frame {self.frame.index}: {said}{products or 'nothing asked for'}>"

    @property
    def solution(self) -> tuple[Estimate, Patch]:
        """Estimate and patch; ValueError where they were not asked for."""
        if self.estimate is None or self.patch is None:
            raise ValueError("the products estimate and patch were not asked for")
        return self.estimate, self.patch

    @property
    def trusted_estimate(self) -> Estimate | None:
        """The estimate, if its numbers are to be trusted."""
        return self.estimate if self.estimate is not None and self.estimate.trusted else None

    @property
    def trusted_patch(self) -> Patch | None:
        """The patch, if it is of an estimate to be trusted."""
        return None if self.trusted_estimate is None else self.patch
