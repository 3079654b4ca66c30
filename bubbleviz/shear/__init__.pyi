from .flow_observer import (
    BLOCK_PX as BLOCK_PX,
)
from .optical_flow import (
    FlowField as FlowField,
    FlowPreset as FlowPreset,
    OpticalFlow as OpticalFlow,
)
from .slip import (
    SlipFinder as SlipFinder,
    SlipStart as SlipStart,
)
from .texture_flow import (
    COLLECTED as COLLECTED,
    PassingTexture as PassingTexture,
    recorded_texture as recorded_texture,
    watch_recorded_texture as watch_recorded_texture,
)
from .traction_estimator import (
    TractionEstimator as TractionEstimator,
    TractionOptions as TractionOptions,
    TractionStart as TractionStart,
)
from .traction_problem import (
    within_cone as within_cone,
)
