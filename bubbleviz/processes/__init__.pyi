from .dask_cluster import check_cluster as check_cluster, run_on_cluster as run_on_cluster
from .pipeline_process import DEPTH_PRODUCTS as DEPTH_PRODUCTS, PipelineProcess as PipelineProcess
from .worker_process import (
    MEMORY_LIMIT_BYTES as MEMORY_LIMIT_BYTES,
    PeakMemory as PeakMemory,
    WorkerProcess as WorkerProcess,
)
from .worker_server import serve as serve
