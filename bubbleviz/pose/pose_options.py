"""Options of pose estimation, each with unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PressOptions:
    """How an object is pressed into the membrane."""

    # how far a face sinks into the membrane under twice the gauge pressure, and an edge under the
    # membrane's tension: far below depth noise, and still not stiffer than the membrane's own
    # triangles, so that Newton's method goes on without a line search
    softness_m: float = 2e-5
    # distance of the object's points in edges of the mesh: several share a triangle, and edges, on
    # which they are twice as dense, pass from one triangle to the next without a jump
    spacing_edges: float = 0.5
    # way around the patch in which the membrane is followed exactly. Further away it turns by some
    # degrees, and linear equations leave 0.01 to 0.04 mm.
    reach_m: float = 8e-3
    # by how much more at first, so that the contact may move that far before another part of the
    # membrane is followed
    margin_m: float = 8e-3
    # way around the patch in which the mesh is twice as fine; 0: nowhere
    finer_m: float = 0.0
    # depth inside the membrane beyond which a point belongs to the far side of the object
    deepest_m: float = 6e-3
    # cosine between the normals of object and membrane beyond which they face the same way
    sideways: float = -0.1
    # Newton step that is none: it moves no pixel by more than a tenth of its noise
    settled_m: float = 1e-4
    # Newton steps are cut to this: the size of a triangle, beyond which the contact is another
    longest_step_m: float = 3e-3
    # most of them for one pose; from the estimated membrane some four are needed
    newton_steps: int = 10


@dataclass(frozen=True)
class ImageOptions:
    """How the pose is fitted to the depth image."""

    press: PressOptions = PressOptions()
    # way around the patch in which pixels are compared: the membrane smooths out what is further
    around_m: float = 8e-3
    most_pixels: int = 6_000  # pixels beyond which more of them say too little for their time
    # share of the pixels' information that is left: what the facets of the model get wrong lasts
    # until the object's edge is on others, and has twice the variance of the noise averaged over
    # that time
    trust: float = 0.3
    outlying: float = 4.0  # residual in standard deviations from which a pixel is no witness
    least_sigma_m: float = 5e-4  # noise below which it is the model that is wrong
    # how far off the membrane around the contact may be, as motions of the object in the directions
    # that the contact determines would move it: stiffness and gas are known no better
    model_deviation_m: float = 5e-4
    # radius of edges, which are modelled sharp: objects are rounded there, and a membrane of some
    # thickness does not follow them
    rounding_m: float = 1e-3
    # longest step of the patch's edge: the membrane around an edge is curved over some millimetres,
    # and derivatives hold over half of that
    step_m: float = 1.5e-3
    # valid_m, settled_m: way of the patch's edge over which the linear model is kept from frame to
    # frame before it is known how much it misses, and below which the first pose of an object is
    # settled
    valid_m: float = 5e-4
    settled_m: float = 2e-4
    # error that a kept linear model may bring into the pose, over the pose's standard deviation. It
    # lasts from frame to frame, and is not averaged out as noise is.
    missed_share: float = 0.1
    # first_steps, next_steps: most linear models in a first frame and in those that follow it
    first_steps: int = 10
    next_steps: int = 2


@dataclass(frozen=True)
class StageOptions:
    """How the two stages of registration run."""

    # close_m, far_m: how far off a prediction, and a start, may be
    close_m: float = 2e-3
    far_m: float = 5e-3
    # tracking, converging, looking: iterations of each stage while tracking, where the depth image
    # goes on from there; from a start; and to compare starts
    tracking: int = 1
    converging: int = 12
    looking: int = 6
    # share of the patch that must lie on an object that nobody said was there
    found_fitness: float = 0.7


@dataclass(frozen=True)
class TrackingOptions:
    """When an object is lost, and how it is searched for."""

    # share of the patch below which it is not this object at this pose that touches
    least_fitness: float = 0.5
    # fastest_m_per_s, fastest_rad_per_s: speed that nothing pressed into a bubble reaches
    fastest_m_per_s: float = 1.0
    fastest_rad_per_s: float = 10.0
    longest_gap_s: float = 1.0  # time between frames over which motion tells nothing any more
    # starts_a_frame, starts_at_first: coarse starts tried in a frame, so that no frame waits for
    # the search, and in a first one
    starts_a_frame: int = 4
    starts_at_first: int = 12
    finalists_at_first: int = 2  # the best of these, which are followed to the end


@dataclass(frozen=True)
class PoseOptions:
    """All of the pose's."""

    stages: StageOptions = StageOptions()
    image: ImageOptions = ImageOptions()
    tracking: TrackingOptions = TrackingOptions()
