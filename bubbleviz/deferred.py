"""Parts of other packages that they load at import but that we may never use: loaded when used."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class _Deferred(ModuleType):
    """Stands for a module until something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def import_without(package: str, part: str) -> None:
    """Import a package, one of its modules only when something of that is asked for.

    `import open3d` loads a web server for `open3d.visualization`, which is two thirds of its time;
    pyvista loads `matplotlib.pyplot` for one function. Does nothing when the package is loaded.

    Parameters
    ----------
    package, part : str
        Of `package.part`.
    """
    if package in sys.modules:
        return
    name = f"{package}.{part}"
    deferred = _Deferred(name)
    deferred.__spec__ = ModuleSpec(name, None)
    sys.modules[name] = deferred
    try:
        module = importlib.import_module(package)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    if not hasattr(module, part):
        setattr(module, part, deferred)
