from .depth_noise import (
    DepthNoise as DepthNoise,
    dome as dome,
    resized as resized,
    with_nodes as with_nodes,
    with_noise as with_noise,
    with_pixels as with_pixels,
)
from .inflated_rubber import (
    ATMOSPHERE_PA as ATMOSPHERE_PA,
    CAMERA_NOISE as CAMERA_NOISE,
    InflatedRubber as InflatedRubber,
    still_frames as still_frames,
)
from .known_press import (
    Validation as Validation,
    mean_frame as mean_frame,
    validate_press as validate_press,
)
from .live_scenes import (
    default_press as default_press,
    finger_pose as finger_pose,
    grip_poses as grip_poses,
    oversized_nut as oversized_nut,
    simulation as simulation,
)
from .presses import (
    GRID_OBJECTS as GRID_OBJECTS,
    HELD_OUT_OBJECTS as HELD_OUT_OBJECTS,
    SMOOTH_OBJECTS as SMOOTH_OBJECTS,
    Press as Press,
    press_path as press_path,
    presses as presses,
    study_object as study_object,
    touching_height as touching_height,
)
from .printed_speckle import (
    GREY_NOISE as GREY_NOISE,
    PrintedMembrane as PrintedMembrane,
)
from .rubber_truth import (
    EDGE_RADIUS_M as EDGE_RADIUS_M,
    LINEAR_NODES as LINEAR_NODES,
    TRUTH_NODES as TRUTH_NODES,
    LinearPresses as LinearPresses,
    Presses as Presses,
    RubberPresses as RubberPresses,
    SimulatedPress as SimulatedPress,
    refined_press as refined_press,
    rubber_sensor as rubber_sensor,
)
from .synthetic_source import (
    NODE_RATIO as NODE_RATIO,
    LoopedSource as LoopedSource,
    Model as Model,
    SyntheticSource as SyntheticSource,
    Truth as Truth,
    default_path as default_path,
    iou as iou,
    truth_of as truth_of,
)
from .truth_bank import TruthBank as TruthBank, noise_name as noise_name
from .truth_file import (
    RecordingWithTruth as RecordingWithTruth,
    read_truth as read_truth,
    with_truth_file as with_truth_file,
)
