"""Owns exports that are imported on first use, so that importing a package costs nothing.

Knows nothing of what is exported. A package calls :func:`export` with the
module of every public name; type checkers see ordinary imports beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["export"]


class _LazyPackage(ModuleType):
    """A package whose public names are found in their modules when first asked for."""

    _homes: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dict__.get("_homes", {}):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{self.__name__}.{self._homes[name]}"), name)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # The import system binds a submodule in its package once it is loaded. Where a public
        # name is that of its module (`replay` in `relax.replay`), the public name wins, whoever
        # imported the module first.
        if isinstance(value, ModuleType) and self._homes.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._homes})


def export(package: str, homes: Mapping[str, str]) -> None:
    """Make public names of a package importable without importing their modules yet.

    Parameters
    ----------
    package : str
        ``__name__`` of the package, while it is being imported.
    homes : mapping of str to str
        Public name, and the module in the package that defines it.

    Examples
    --------
    >>> import relax
    >>> from relax.replay import Replay
    >>> callable(relax.replay), relax.Replay is Replay
    (True, True)
    """
    module = sys.modules[package]
    module.__dict__["_homes"] = dict(homes)
    module.__class__ = _LazyPackage
