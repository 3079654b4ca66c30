"""Faster imports: defer modules that may never be used."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_ATTEMPTS = 9
"""Tries at an import that other threads' imports disturb; one is enough but by rare chance."""


class _Deferred(ModuleType):
    """Stands for a module until something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def import_without(package: str, part: str) -> None:
    """Import a package but defer one of its modules until an attribute of it is used.

    `import open3d` loads a web server for `open3d.visualization`, which is two thirds of its time;
    pyvista loads `matplotlib.pyplot` for one function. Does nothing when the part is loaded.

    Parameters
    ----------
    package, part : str
        Of `package.part`.
    """
    if (name := f"{package}.{part}") in sys.modules:
        return
    deferred = _deferred(name)
    try:
        module = _imported(package)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    if part not in vars(module):  # `hasattr` would have numpy import it
        setattr(module, part, deferred)


def _imported(package: str) -> ModuleType:
    """Import a package, again where another thread's import got in its way.

    Open3D goes through `sys.modules`, which fails while another thread imports.
    """
    for _ in range(_ATTEMPTS - 1):
        try:
            return importlib.import_module(package)
        except RuntimeError as error:
            if "changed size during iteration" not in str(error):
                raise
    return importlib.import_module(package)


def import_later(package: str) -> None:
    """Defer the import of a package until an attribute of it is used.

    pyvista loads one for downloads, with SSL and progress bars. Does nothing when it is loaded.
    """
    if package not in sys.modules:
        _deferred(package)


def _deferred(name: str) -> ModuleType:
    """Put a placeholder in `sys.modules` that imports the module when first used."""
    made = _Deferred(name)
    made.__spec__ = ModuleSpec(name, None)
    sys.modules[name] = made
    return made


@contextmanager
def defer_class(module: str, cls: str) -> Iterator[None]:
    """Replace a class, imported by name within the block, by a factory that imports it when called.

    pyvista would load Matplotlib's figure drawing, for a chart that is not used. Does nothing
    when the module is loaded.

    Parameters
    ----------
    module, cls : str
        Of `module.cls`.
    """
    if module in sys.modules:
        yield
        return

    def make(*args: Any, **kwargs: Any) -> Any:
        return getattr(importlib.import_module(module), cls)(*args, **kwargs)

    meanwhile = ModuleType(module)
    setattr(meanwhile, cls, make)
    sys.modules[module] = meanwhile
    try:
        yield
    finally:
        del sys.modules[module]  # later imports get the real module


@contextmanager
def hide_package(package: str) -> Iterator[None]:
    """Make a package look uninstalled within the block.

    pyvista would load mypy wherever that is, for a plugin of it. Does nothing when it is loaded.
    """
    if package in sys.modules:
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]  # what makes Python not find it
    try:
        yield
    finally:
        del sys.modules[package]


@contextmanager
def everything_stays() -> Iterator[None]:
    """Import many modules without looking for garbage: all they make stays until the end.

    Python would look again and again at all that is loaded, a quarter of the time of the imports.
    """
    looked = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if looked:
            gc.enable()
