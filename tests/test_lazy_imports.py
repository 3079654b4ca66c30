"""What is not used is not imported, nor what other packages import needlessly."""

import importlib.util

import pytest

from tests.program import python


def printed(code, *arguments):
    """Words that code prints in a process of its own."""
    return python(code, *arguments).split()


QT = ("PySide6", "pyqtgraph", "pyvista", "pyvistaqt", "vtkmodules")
WINDOW = (*QT, "bubbleviz_ui")
HEAVY = ("numpy", "scipy", "pydantic", "osqp", "open3d", "rosbags", "matplotlib", "pandas")
MAIN = "import click; from bubbleviz.cli.command_line import VERBS, main\n"
HELP = MAIN + "for name in {}: main([name, '--help'], standalone_mode=False)"
COMMAND = MAIN + "main({!r}.split() + sys.argv[1:], standalone_mode=False)"
UNUSED = {
    "the library, help of commands without a window": (HELP.format("VERBS"), (*HEAVY, *WINDOW)),
    "help of the program and of every command": (
        HELP.format("main.list_commands(click.Context(main))")
        + "\nmain(['--help'], standalone_mode=False)",
        (*HEAVY, *QT),
    ),
    "a worker, which has to choose its threads first": (
        "import bubbleviz.processes.worker_server", ("numpy",),
    ),
    "recordings and pipeline": (
        "import bubbleviz.pipeline, bubbleviz.recordings.recording",
        ("zenoh", "mcap", "pyrealsense2"),
    ),
    "estimate": (COMMAND.format("estimate"), (*WINDOW, "matplotlib", "pandas", "bubbleviz.pose")),
    "first frame of the built-in press": (
        "from bubbleviz.sensor import load_sensor\n"
        "from bubbleviz_ui.engine.source import SYNTHETIC\n"
        "SYNTHETIC.open(load_sensor('pico_flexx_75mm'))[0]",
        ("open3d", "osqp", "matplotlib"),
    ),
    "export of depth pictures": (
        COMMAND.format("export --what depth"), (*WINDOW, "open3d", "osqp", "clarabel", "pyarrow"),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("code", "names"), UNUSED.values(), ids=UNUSED)
def test_what_is_not_used_is_not_imported(code, names, press, sensor, tmp_path):
    out = tmp_path / ("out.npz" if "estimate" in code else "out")
    words = (press, "--sensor", sensor, "--frames", "0:2", "--out", out)
    listed = f"print('loaded', *({set(names)} & set(sys.modules)))"
    assert printed(f"import sys; {code}\n{listed}", *words)[-1] == "loaded"


CODE = """
import sys
from bubbleviz.lazy_imports import import_without
import_without({package!r}, {part!r})
{first}
print({heavy!r} in sys.modules)
{then}
print({heavy!r} in sys.modules)
"""


@pytest.mark.parametrize(
    ("package", "part", "heavy", "first", "then"),
    [
        (
            "open3d", "visualization", "dash",
            "from open3d.pipelines import registration",
            "import open3d.visualization as v; assert callable(v.draw_plotly)",
        ),
        (
            "matplotlib", "pyplot", "matplotlib.figure",
            "import pyvista.plotting.colors; import matplotlib.pyplot as plt",
            "from matplotlib import pyplot; assert callable(pyplot.subplots);"
            "import matplotlib.pyplot as plt; plt.figure()",
        ),
        (
            "numpy", "f2py", "numpy.f2py.crackfortran",
            "from numpy import *; import numpy; numpy.f2py",
            "import numpy; assert callable(numpy.f2py.run_main)",
        ),
    ],
)  # fmt: skip
def test_a_part_is_loaded_when_it_is_used(package, part, heavy, first, then):
    code = CODE.format(package=package, part=part, heavy=heavy, first=first, then=then)
    assert printed(code) == ["False", "True"]


def test_a_package_is_loaded_when_something_of_it_is_used():
    code = (
        "import sys; from bubbleviz.lazy_imports import import_later; import_later('pooch')\n"
        "import pyvista; print('pooch.core' in sys.modules)\n"
        "from pyvista.core.utilities import reader_registry\n"
        "assert callable(reader_registry.pooch.retrieve)\n"
        "print('pooch.core' in sys.modules)\n"
        "import pooch; assert pooch.__version__; import_later('pooch'); import pooch.core"
    )
    assert printed(code) == ["False", "True"]


def test_the_window_starts_without_what_its_first_picture_does_not_need():
    code = (
        "import sys; from bubbleviz_ui.startup_imports import import_the_window\n"
        "import_the_window()\n"
        "print(sorted(set(sys.argv[1:]) & set(sys.modules)))\n"
        "from scipy import ndimage; assert ndimage.label([0, 1, 1])[1] == 1"
    )
    unneeded = (
        "bubbleviz.api.converting",
        "bubbleviz.output.series",
        "bubbleviz_ui.importing.import_dialog",
        "matplotlib.figure",
        "mypy",
        "open3d",
        "pooch.core",
        "qtpy",
        "scipy.ndimage._filters",
    )
    assert all(importlib.util.find_spec(name) for name in unneeded)
    assert printed(code, *unneeded) == ["[]"]


def test_a_class_that_others_import_by_name_is_loaded_when_one_is_made():
    code = (
        "import sys; from bubbleviz.lazy_imports import import_without, defer_class\n"
        "import_without('matplotlib', 'pyplot')\n"
        "with defer_class('matplotlib.backends.backend_agg', 'FigureCanvasAgg'):\n"
        "    import pyvista.plotting.charts\n"
        "print('matplotlib.backends._backend_agg' in sys.modules)\n"
        "import matplotlib.pyplot as plt; figure, axes = plt.subplots(); axes.plot([0, 1])\n"
        "from matplotlib.backends.backend_agg import FigureCanvasAgg as named\n"
        "print(isinstance(named, type), type(pyvista.ChartMPL(figure)._canvas).__module__)"
    )
    assert printed(code) == ["False", "True", "matplotlib.backends.backend_agg"]


def test_what_is_imported_meanwhile_stays_and_garbage_is_collected_again():
    code = (
        "import gc; from bubbleviz.lazy_imports import without_garbage_collection\n"
        "with without_garbage_collection(): import fractions; print(gc.isenabled())\n"
        "print(gc.isenabled(), gc.get_freeze_count() > 1000)\n"
        "import weakref\n"
        "class Ring: pass\n"
        "ring = Ring(); ring.itself = ring; gone = weakref.ref(ring); del ring; gc.collect()\n"
        "print(gone())"
    )
    assert printed(code) == ["False", "True", "True", "None"]


def test_a_package_that_is_not_there_leaves_nothing():
    code = (
        "import sys; from bubbleviz.lazy_imports import import_without\n"
        "try: import_without('no_such_package', 'part')\n"
        "except ModuleNotFoundError: print([m for m in sys.modules if 'no_such' in m])"
    )
    assert printed(code) == ["[]"]


def test_an_import_that_another_thread_disturbs_is_repeated():
    """Open3D iterates over all modules; one name adds another meanwhile, as a thread may."""
    code = (
        "import sys, types\n"
        "class Name(str):\n"
        "    asked = 0\n"
        "    def __contains__(self, part):\n"
        "        Name.asked += 1\n"
        "        if Name.asked < 3: sys.modules[f'other{Name.asked}'] = types.ModuleType('other')\n"
        "        return super().__contains__(part)\n"
        "sys.modules[Name('disturbing')] = types.ModuleType('disturbing')\n"
        "from bubbleviz.lazy_imports import import_without\n"
        "import_without('open3d', 'visualization')\n"
        "from open3d import core; from open3d.t.geometry import RaycastingScene\n"
        "RaycastingScene(); print(Name.asked, 'dash' in sys.modules)\n"
        "import open3d; assert callable(open3d.visualization.draw_plotly)"
    )
    asked, heavy = printed(code)
    assert int(asked) > 3 and heavy == "False"
