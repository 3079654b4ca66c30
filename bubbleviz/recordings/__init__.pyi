from .bag import Bag as Bag, Messages as Messages, Topic as Topic, typestore as typestore
from .colour_topics import (
    STATIC_TRANSFORMS as STATIC_TRANSFORMS,
    TRANSFORMS as TRANSFORMS,
    StaticPoses as StaticPoses,
    are_static_poses as are_static_poses,
    belongs_to as belongs_to,
    colour_camera as colour_camera,
    is_called_colour as is_called_colour,
    is_own as is_own,
    size_of as size_of,
)
from .contact_free import (
    SIGNIFICANT as SIGNIFICANT,
    ContactFree as ContactFree,
    find_contact_free as find_contact_free,
    tile_depths as tile_depths,
)
from .depth_statistics import (
    LAG as LAG,
    MIN_FRAMES as MIN_FRAMES,
    DepthStatistics as DepthStatistics,
    correlated_samples as correlated_samples,
    error_of_mean as error_of_mean,
    mean_inflation as mean_inflation,
    measure_depth as measure_depth,
    robust_sigma as robust_sigma,
    spatial_correlation as spatial_correlation,
    student_factor as student_factor,
    temporal_correlation as temporal_correlation,
    tukey_loss as tukey_loss,
    tukey_slopes as tukey_slopes,
    tukey_weights as tukey_weights,
    upper_fence as upper_fence,
)
from .depth_topics import (
    CAMERA_INFO as CAMERA_INFO,
    COMPRESSED_IMAGE as COMPRESSED_IMAGE,
    IMAGE as IMAGE,
    MARKERS as MARKERS,
    POINT_CLOUD as POINT_CLOUD,
    PRESSURE as PRESSURE,
    RESULTS as RESULTS,
    STRING as STRING,
    WRENCH as WRENCH,
    nearest_info as nearest_info,
)
from .frame import (
    FROZEN_AFTER as FROZEN_AFTER,
    NO_COLOUR as NO_COLOUR,
    CachedFrames as CachedFrames,
    EqualImages as EqualImages,
    Frame as Frame,
    FrameSource as FrameSource,
    Gap as Gap,
    HeldFrames as HeldFrames,
    TimeAxis as TimeAxis,
    find_gaps as find_gaps,
    shown_name as shown_name,
    usual_step as usual_step,
)
from .image_folder import ImageFolder as ImageFolder, is_image_folder as is_image_folder
from .mcap_file import (
    Flushed as Flushed,
    McapFile as McapFile,
)
from .message_decoding import (
    COMPRESSED as COMPRESSED,
    begins_as_cdr as begins_as_cdr,
    check_unit as check_unit,
    decode_cloud as decode_cloud,
    decode_depth as decode_depth,
    decode_intrinsics as decode_intrinsics,
    distortion_of as distortion_of,
    has_returns as has_returns,
    header_stamp_ns as header_stamp_ns,
    metres as metres,
)
from .message_encoding import (
    Encoding as Encoding,
    FrameMessages as FrameMessages,
    Message as Message,
    make_header as make_header,
    make_pose as make_pose,
    make_static_pose as make_static_pose,
    make_wrench as make_wrench,
    ros2_types as ros2_types,
    serialise as serialise,
)
from .recorded_colour import (
    ColourAround as ColourAround,
    FrameColour as FrameColour,
    Texture as Texture,
    half_step_ns as half_step_ns,
    placed as placed,
)
from .recording import (
    Recording as Recording,
    force_of as force_of,
    measured_force as measured_force,
    open_recording as open_recording,
)
from .recording_writer import RecordingWriter as RecordingWriter
from .sensor_matching import (
    AUTO as AUTO,
    WEATHER_PA as WEATHER_PA,
    check_fits as check_fits,
    check_gas_unit as check_gas_unit,
    checked_sensor as checked_sensor,
    fitting_sensor as fitting_sensor,
    gas_warning as gas_warning,
    image_size as image_size,
    preset_of_size as preset_of_size,
)
from .time_series import (
    FORWARD_NS as FORWARD_NS,
    GARBAGE_NS as GARBAGE_NS,
    NEAREST_NS as NEAREST_NS,
    VALUES as VALUES,
    GrowingSeries as GrowingSeries,
    Moment as Moment,
    Series as Series,
    StampClock as StampClock,
    Verdict as Verdict,
    values_at as values_at,
)
