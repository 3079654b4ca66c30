from .dual_stage import (
    InitialPoseFinder as InitialPoseFinder,
    looking_different as looking_different,
    touching_directions as touching_directions,
)
from .image_fit import (
    ImageFit as ImageFit,
)
from .motion import (
    START_DEVIATION as START_DEVIATION,
    Motion as Motion,
    about as about,
    motion_between as motion_between,
    moved as moved,
    rows as rows,
    way_at as way_at,
)
from .object_patch import (
    ObjectPatchFinder as ObjectPatchFinder,
)
from .pressed_membrane import (
    ROUNDING_M as ROUNDING_M,
    ObjectContact as ObjectContact,
    PressedMembrane as PressedMembrane,
    PressOptions as PressOptions,
    contact_samples as contact_samples,
)
from .registration import (
    MIN_RADIUS_M as MIN_RADIUS_M,
    ContactPoints as ContactPoints,
    Directions as Directions,
    Precision as Precision,
    Registration as Registration,
    contact_points as contact_points,
    directions as directions,
    object_distance as object_distance,
    open_axes as open_axes,
    spins as spins,
)
from .tracker import (
    MAX_GAP_S as MAX_GAP_S,
    UNKNOWN_S as UNKNOWN_S,
    PoseTracker as PoseTracker,
    check_size as check_size,
    precision_of as precision_of,
)
