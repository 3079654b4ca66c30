from .assembler import WAIT_NS as WAIT_NS, Counters as Counters, FrameAssembler as FrameAssembler
from .live_source import (
    LiveSource as LiveSource,
    OfferedTopic as OfferedTopic,
    parse_uri as parse_uri,
)
from .live_stream import (
    STALE_AFTER_S as STALE_AFTER_S,
    STOPPED_AFTER_S as STOPPED_AFTER_S,
    LatencyMeter as LatencyMeter,
    LatencyReport as LatencyReport,
    LiveStream as LiveStream,
    State as State,
    Status as Status,
    status_of as status_of,
)
from .opening import (
    LiveSensor as LiveSensor,
    LiveSession as LiveSession,
    SensorPlace as SensorPlace,
    SessionPreset as SessionPreset,
    is_simulated as is_simulated,
    load_session as load_session,
    open_stream as open_stream,
    sensor_for_source as sensor_for_source,
)
from .publisher import ZenohPublisher as ZenohPublisher
from .recorder import Recorder as Recorder, RecorderStatus as RecorderStatus
from .replay import Replay as Replay, SyntheticLive as SyntheticLive
from .result_messages import (
    DIAGNOSTICS as DIAGNOSTICS,
    POSE as POSE,
    RESULT_TOPICS as RESULT_TOPICS,
    ResultMessages as ResultMessages,
    ResultSender as ResultSender,
)
from .topic_names import (
    DEPTH_TYPES as DEPTH_TYPES,
    TopicNames as TopicNames,
    is_used as is_used,
    stamp_of as stamp_of,
)
from .zenoh_session import (
    ROUTER as ROUTER,
    Credentials as Credentials,
    SessionOptions as SessionOptions,
    listening_warning as listening_warning,
    open_session as open_session,
)
from .zenoh_source import ZenohSource as ZenohSource
