from .colour_image import (
    COMPRESSED_ENCODINGS as COMPRESSED_ENCODINGS,
    MAX_SIDE as MAX_SIDE,
    ColourCamera as ColourCamera,
    ColourImage as ColourImage,
    EncodedImage as EncodedImage,
    check_rows as check_rows,
    readable as readable,
)
from .flow_observer import (
    BLOCK_PX as BLOCK_PX,
    FlowField as FlowField,
    FlowObserver as FlowObserver,
    MeasuredFlow as MeasuredFlow,
    PinnedPoints as PinnedPoints,
)
from .image_change import ImageChange as ImageChange
from .image_errors import (
    IMAGE_ERRORS as IMAGE_ERRORS,
    OF_RANGES as OF_RANGES,
    SHIFTS as SHIFTS,
    ImageErrors as ImageErrors,
    camera_shift as camera_shift,
    range_errors as range_errors,
    range_shifts as range_shifts,
)
from .intrinsics import (
    DepthCamera as DepthCamera,
    DistortionModel as DistortionModel,
    Intrinsics as Intrinsics,
)
from .observer import (
    MAD as MAD,
    SQUARES as SQUARES,
    UPPER_95 as UPPER_95,
    BlockSquares as BlockSquares,
    Measured as Measured,
    Misfit as Misfit,
    Observation as Observation,
    RangeObserver as RangeObserver,
    ShapeRanges as ShapeRanges,
    facet_error as facet_error,
    median as median,
    row_median as row_median,
)
from .pixel_model import (
    PixelModel as PixelModel,
    RangeLine as RangeLine,
)
from .raycast import (
    MembraneView as MembraneView,
    RayCaster as RayCaster,
    sparse_rows as sparse_rows,
    vector_columns as vector_columns,
)
