"""Owns the exceptions a caller may catch. Knows nothing of trips, solvers or files."""

from __future__ import annotations

__all__ = ["DomainError", "EvrelaxError", "InputError"]


class EvrelaxError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(EvrelaxError, ValueError):
    """A value in an input is not allowed.

    Parameters
    ----------
    source : str
        File or object the value came from. Where the value is the file itself, its name is
        told once.
    field : str
        Dotted name of the field, e.g. ``charger.2.power_kw``.
    value : object
        The offending value; ``None`` when it is missing.
    allowed : str
        What would be accepted, as a phrase.
    """

    def __init__(self, source: str, field: str, value: object, allowed: str) -> None:
        self.source, self.field, self.value, self.allowed = source, field, value, allowed
        shown = "missing" if value is None else repr(value)
        itself = value == source if isinstance(value, str) else False
        if len(shown) > 80 and not itself:
            shown = shown[:77] + "..."
        origin = "" if itself else f"{source}: "
        super().__init__(f"{origin}{field}: {shown}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, str, object, str]]:
        """Return how to make it again, in another process too."""
        return type(self), (self.source, self.field, self.value, self.allowed)


class DomainError(EvrelaxError, ValueError):
    """A map was asked for a value outside its table; maps never extrapolate."""
