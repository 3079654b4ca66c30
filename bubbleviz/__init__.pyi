from .api.batching import (
    batch as batch,
)
from .api.checking import (
    check as check,
)
from .api.comparing import (
    compare as compare,
)
from .api.connecting import (
    connect as connect,
)
from .api.converting import (
    convert as convert,
)
from .api.estimating import (
    estimate as estimate,
    register as register,
    track as track,
)
from .api.estimator import (
    Estimator as Estimator,
)
from .api.exporting import (
    export as export,
)
from .api.frames import (
    info as info,
    open as open,
)
from .api.identifying import (
    identify as identify,
)
from .api.installation import (
    doctor as doctor,
    presets as presets,
)
from .api.recording import (
    publish as publish,
    record as record,
)
from .api.results import (
    load_run as load_run,
)
from .api.simulating import (
    simulate as simulate,
)
from .api.validating import (
    validate as validate,
)
from .api.watching import (
    watch as watch,
)
from .errors import (
    InputError as InputError,
)
from .sensor import (
    load_sensor as load_sensor,
    save_sensor as save_sensor,
)

__version__: str
