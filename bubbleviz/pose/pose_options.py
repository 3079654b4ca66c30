"""What the pose's stages are set to: each value with its unit and its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PressOptions:
    """How an object is pressed into the membrane.

    Attributes
    ----------
    softness_m : float
        How far a face sinks into the membrane under twice the gauge pressure, and an edge under the
        membrane's tension: far below depth noise, and still not stiffer than the membrane's
        own triangles, so that Newton's method goes on without a line search.
    spacing_edges : float
        Distance of the object's points in edges of the mesh: several share a triangle, and edges,
        on which they are twice as dense, pass from one triangle to the next without a jump.
    reach_m : float
        Way around the patch in which the membrane is followed exactly. Further away it turns by
        some degrees, and linear equations leave 0.02 mm.
    margin_m : float
        By how much more at first, so that the contact may move that far before another part of the
        membrane is followed.
    deepest_m : float
        Depth inside the membrane beyond which a point belongs to the far side of the object.
    sideways : float
        Cosine between the normals of object and membrane beyond which they face the same way.
    settled_m : float
        Newton step that is none: it moves no pixel by more than a tenth of its noise.
    longest_step_m : float
        Newton steps are cut to this: the size of a triangle, beyond which the contact is another.
    newton_steps : int
        Most of them for one pose; from the estimated membrane some four are needed.
    """

    softness_m: float = 2e-5
    spacing_edges: float = 0.5
    reach_m: float = 20e-3
    margin_m: float = 8e-3
    deepest_m: float = 6e-3
    sideways: float = -0.1
    settled_m: float = 1e-4
    longest_step_m: float = 3e-3
    newton_steps: int = 10


@dataclass(frozen=True)
class ImageOptions:
    """How the pose is fitted to the depth image.

    Attributes
    ----------
    press : PressOptions
    around_m : float
        Way around the patch in which pixels are compared: the membrane smooths out what is further.
    most_pixels : int
        Pixels beyond which more of them say too little for their time.
    trust : float
        Share of the pixels' information that is left: what the facets of the model get wrong lasts
        until the object's edge is on others, and has twice the variance of the noise averaged over
        that time.
    outlying : float
        Residual in standard deviations from which a pixel is no witness.
    least_sigma_m : float
        Noise below which it is the model that is wrong.
    model_deviation_m : float
        How far off the membrane around the contact may be, as motions of the object in the
        directions that the contact determines would move it: stiffness and gas are known no better.
    rounding_m : float
        Radius of edges, which are modelled sharp: objects are rounded there, and a membrane of some
        thickness does not follow them.
    step_m : float
        Longest step of the patch's edge: the membrane around an edge is curved over some
        millimetres, and derivatives hold over half of that.
    valid_m, settled_m : float
        Way of the patch's edge over which the linear model is kept from frame to frame, and below
        which the first pose of an object is settled.
    first_steps, next_steps : int
        Most linear models in a first frame and in those that follow it.
    """

    press: PressOptions = PressOptions()
    around_m: float = 8e-3
    most_pixels: int = 6_000
    trust: float = 0.3
    outlying: float = 4.0
    least_sigma_m: float = 5e-4
    model_deviation_m: float = 5e-4
    rounding_m: float = 1e-3
    step_m: float = 1.5e-3
    valid_m: float = 5e-4
    settled_m: float = 2e-4
    first_steps: int = 10
    next_steps: int = 2


@dataclass(frozen=True)
class StageOptions:
    """How the two stages of registration run.

    Attributes
    ----------
    close_m, far_m : float
        How far off a prediction, and a start, may be.
    tracking, converging, looking : int
        Iterations of each stage while tracking, from a start, and to compare starts.
    found_fitness : float
        Share of the patch that must lie on an object that nobody said was there.
    """

    close_m: float = 2e-3
    far_m: float = 5e-3
    tracking: int = 3
    converging: int = 12
    looking: int = 6
    found_fitness: float = 0.7


@dataclass(frozen=True)
class TrackingOptions:
    """When an object is lost, and how it is searched for.

    Attributes
    ----------
    least_fitness : float
        Share of the patch below which it is not this object at this pose that touches.
    fastest_m_per_s, fastest_rad_per_s : float
        Speed that nothing pressed into a bubble reaches.
    longest_gap_s : float
        Time between frames over which motion tells nothing any more.
    starts_a_frame, starts_at_first : int
        Coarse starts tried in a frame, so that no frame waits for the search, and in a first one.
    finalists_at_first : int
        The best of these, which are followed to the end.
    """

    least_fitness: float = 0.5
    fastest_m_per_s: float = 1.0
    fastest_rad_per_s: float = 10.0
    longest_gap_s: float = 1.0
    starts_a_frame: int = 4
    starts_at_first: int = 12
    finalists_at_first: int = 2


@dataclass(frozen=True)
class PoseOptions:
    """All of the pose's.

    Attributes
    ----------
    stages : StageOptions
    image : ImageOptions
    tracking : TrackingOptions
    """

    stages: StageOptions = StageOptions()
    image: ImageOptions = ImageOptions()
    tracking: TrackingOptions = TrackingOptions()
