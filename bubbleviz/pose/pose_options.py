"""Options of pose estimation, each with unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PressOptions:
    """How an object is pressed into the membrane."""

    # penetration of a face under twice the gauge pressure, and of an edge under the membrane's
    # tension: far below depth noise, yet not stiffer than the membrane's own triangles, so that
    # Newton's method converges without a line search
    softness_m: float = 2e-5
    # distance of the object's points in edges of the mesh: several share a triangle, and edges, on
    # which they are twice as dense, pass from one triangle to the next without a jump
    spacing_edges: float = 0.5
    # distance around the patch in which the membrane is solved exactly. Further away it turns by a
    # few degrees, and linear equations have errors of 0.01 to 0.04 mm.
    reach_m: float = 8e-3
    # additional distance, so that the contact may move that far before another part of the membrane
    # is solved
    margin_m: float = 8e-3
    # distance around the patch in which the mesh is twice as fine; 0: nowhere
    finer_m: float = 0.0
    # depth inside the membrane beyond which a point belongs to the far side of the object
    max_depth_m: float = 6e-3
    # cosine between the direction in which a point pushes and the membrane's normal, below which it
    # is in contact. Beyond 60° the closest membrane is beside the point: that of a wall in the air
    # above the membrane would count as inside it, by rounding.
    max_cosine: float = -0.5
    # Newton step that counts as converged: steps shrink to less than a half, and what is left moves
    # no pixel by more than a tenth of its noise
    converged_m: float = 2e-4
    # limit of a Newton step: the size of a triangle, beyond which the contact changes
    max_step_m: float = 3e-3
    # limit for one pose; from the estimated membrane some four are needed
    max_steps: int = 10


@dataclass(frozen=True)
class ImageOptions:
    """How the pose is fitted to the depth image."""

    # a Newton step of 0.5 mm leaves its square over the size of a triangle: less than 0.1 mm
    press: PressOptions = PressOptions(converged_m=5e-4)
    # distance around the patch in which pixels are compared; the membrane further away hardly moves
    around_m: float = 8e-3
    max_pixels: int = 6_000  # beyond, as many groups of neighbours are averaged
    # weight of the pixels' information: the error of the model's facets persists until the object's
    # edge has moved to others, with twice the variance of the noise averaged over that time
    trust: float = 0.3
    outlier_sigmas: float = 4.0  # residual in standard deviations that reduces a pixel to a quarter
    min_sigma_m: float = 5e-4  # lower bound of the noise, below which model errors dominate
    # model error of the membrane around the contact, as motions of the object in the directions
    # that the contact determines: stiffness and gas are known no better
    model_deviation_m: float = 5e-4
    # radius of edges, which are modelled sharp: objects are rounded there, and the membrane has a
    # thickness
    rounding_m: float = 1e-3
    # longest step of the patch's edge: the membrane around an edge is curved over a few mm, and
    # derivatives are valid over half of that
    step_m: float = 1.5e-3
    # valid_m, converged_m: motion of the patch's edge from that of a linear model up to which it is
    # reused from frame to frame, and the first pose of an object has converged. At two thirds of
    # the longest step the error of the derivatives is less than half.
    valid_m: float = 1e-3
    converged_m: float = 2e-4
    # first_steps, next_steps: maximum number of steps in a first and in later frames, where the
    # first one uses the last linear model, and a press follows only if the pose leaves its range
    first_steps: int = 10
    next_steps: int = 3
