"""Deferred imports of modules that may never be used."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_ATTEMPTS = 9
"""Tries at an import that imports in other threads may disturb, which is rare."""


class _Deferred(ModuleType):
    """Placeholder that imports the module when an attribute is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def import_without(package: str, part: str) -> None:
    """Import a package but defer one of its modules until an attribute of it is used.

    `import open3d` spends two thirds of its time on a web server for `open3d.visualization`;
    pyvista loads `matplotlib.pyplot` for one function. No effect if the part is already loaded.

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
    if part not in vars(module):  # `hasattr` would make numpy import it
        setattr(module, part, deferred)


def _imported(package: str) -> ModuleType:
    """Import a package, and retry if an import in another thread interferes.

    Open3D iterates over `sys.modules`, which fails during an import in another thread.
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

    pyvista loads one for downloads, with SSL and progress bars. No effect if already loaded.
    """
    if package not in sys.modules:
        _deferred(package)


def _deferred(name: str) -> ModuleType:
    """Put a placeholder in `sys.modules` that imports the module when first used."""
    placeholder = _Deferred(name)
    placeholder.__spec__ = ModuleSpec(name, None)
    sys.modules[name] = placeholder
    return placeholder


@contextmanager
def substitute_modules(modules: Mapping[str, ModuleType | None]) -> Iterator[None]:
    """Import others within the block as if these were loaded; None: as if it were not installed.

    Later imports get the real modules. No effect on those that are already loaded.
    """
    new = {name: module for name, module in modules.items() if name not in sys.modules}
    sys.modules.update(new)  # type: ignore[arg-type]  # None makes imports fail
    try:
        yield
    finally:
        for name in new:
            del sys.modules[name]


def defer_class(module: str, cls: str) -> AbstractContextManager[None]:
    """Replace a class, imported by name within the block, by a factory that imports it when called.

    pyvista would load Matplotlib's figure drawing for an unused chart. No effect if the module is
    already loaded.

    Parameters
    ----------
    module, cls : str
        Of `module.cls`.
    """

    def make(*args: Any, **kwargs: Any) -> Any:
        return getattr(importlib.import_module(module), cls)(*args, **kwargs)

    substitute = ModuleType(module)
    setattr(substitute, cls, make)
    return substitute_modules({module: substitute})


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Import modules without garbage collection, which takes a quarter of the import time.

    Objects created in the block are excluded from later collections.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if enabled:
            gc.enable()


@contextmanager
def quick_imports() -> Iterator[None]:
    """Import modules as `without_garbage_collection`, and without parts of NumPy."""
    for part in ("f2py", "testing"):  # SciPy imports all of NumPy
        import_without("numpy", part)
    with without_garbage_collection():
        yield
