from .optical_flow import (
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
from .traction import (
    traction_of as traction_of,
)
