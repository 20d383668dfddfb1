"""Owns TOML documents: reading, overriding by dotted key, and where a field came from.

Turns every failure into one :class:`~relax.errors.InputError` that names file,
field, value and what is allowed. Knows nothing of what the fields mean.
"""

from __future__ import annotations

import copy
import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources.abc import Traversable
from typing import Any, get_args

from pydantic import BaseModel

from relax.errors import InputError

__all__ = [
    "OVERRIDE",
    "Origin",
    "field_names",
    "one_line",
    "one_of",
    "read_text",
    "read_toml",
    "with_overrides",
]


LONGEST_LIST, NEAREST = 200, 5
"""Characters of names listed in a message; of a longer list, that many of the nearest names."""
OVERRIDE = "override"
"""Source shown for a value that came by override, not from a file."""


@dataclass(frozen=True)
class Origin:
    """Where the fields of one document came from, for error messages.

    Parameters
    ----------
    source : str
        The file.
    replaced : mapping of str to (str, str)
        Field replaced from elsewhere: the source it came from, and what to put
        before the field's name there.
    labels : mapping of str to str
        Table, and the name to show beside its fields.

    Examples
    --------
    >>> origin = Origin("car.toml", {"heater_kw": ("trip.toml", "vehicle.")})
    >>> str(origin.error("heater_kw", -1, "0 or more"))
    'trip.toml: vehicle.heater_kw: -1; allowed: 0 or more'
    """

    source: str
    replaced: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)

    def error(self, name: str, value: object, allowed: str) -> InputError:
        """Return the error for a field of this document."""
        source, prefix = self.source, ""
        for key, origin in self.replaced.items():
            if name == key or name.startswith((key + ".", key + " ")):
                source, prefix = origin
        label = next((v for k, v in self.labels.items() if name.startswith(k + ".")), None)
        shown = one_line(prefix + name) + (f" ({label!r})" if label is not None else "")
        return InputError(source, shown, value, allowed)


def one_line(name: str) -> str:
    r"""Return a name as it is if it can be printed on a line, else quoted.

    Examples
    --------
    >>> print(one_line("soc"), one_line("s\noc"))
    soc 's\noc'
    """
    return name if name.isprintable() else repr(name)


def one_of(names: Iterable[str], wrong: object = None, before: str = "", after: str = "") -> str:
    """Return a phrase with the name closest to ``wrong``, and a list of ``names``.

    Parameters
    ----------
    names : iterable of str
        What is allowed. Many are not all listed, only those nearest to ``wrong``.
    wrong : object
        What was given.
    before, after : str
        What stands around every name.

    Examples
    --------
    >>> one_of(["soc", "name"], "sox")
    "did you mean 'soc'? one of name, soc"
    >>> one_of(["soc", "name"], "x", before="start.")
    'one of start.name, start.soc'
    """
    known = {name: one_line(f"{before}{name}{after}") for name in sorted(names)}
    if not known:
        return "nothing"
    close = difflib.get_close_matches(str(wrong), known, n=1)
    hint = f"did you mean {known[close[0]]!r}? " if close else ""
    listed = ", ".join(known.values())
    if len(listed) <= LONGEST_LIST or len(known) <= NEAREST + 1:
        return f"{hint}one of {listed}"
    near = difflib.get_close_matches(str(wrong), known, n=NEAREST, cutoff=0.0)
    return f"{hint}one of {', '.join(known[n] for n in near)} or {len(known) - len(near)} others"


def read_text(file: Traversable, source: str) -> str:
    """Return the text of a UTF-8 file, without a byte order mark.

    Raises
    ------
    InputError
        The file cannot be read or is not UTF-8.

    Examples
    --------
    >>> from importlib.resources import files
    >>> read_text(files("relax") / "errors.py", "errors.py")[:10]
    '\"\"\"Owns th'
    """
    try:
        return file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(source, "file", source, f"a readable file ({reason})") from error
    except UnicodeDecodeError as error:
        raw = error.object[error.start : error.end]
        raise InputError(source, f"byte {error.start}", raw, "UTF-8 text") from error


def read_toml(file: Traversable, source: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    InputError
        It cannot be read or is not TOML; the field is then the line.

    Examples
    --------
    >>> from importlib.resources import files
    >>> read_toml(files("relax") / "errors.py", "errors.py")
    Traceback (most recent call last):
        ...
    relax.errors.InputError: errors.py: line 1: ...
    """
    text = read_text(file, source)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # too long a number, too deep a list
        lines = text.splitlines() or [""]
        found = re.search(r"\(at line (\d+)", str(error))
        number = int(found[1]) if found else len(lines)
        content = lines[min(number, len(lines)) - 1].strip()
        reason = re.sub(r" \(at .*\)$", "", str(error))
        raise InputError(source, f"line {number}", content, f"valid TOML ({reason})") from error


def field_names(annotation: object) -> set[str]:
    """Return the names of the fields of an annotation that is a model, else none.

    Examples
    --------
    >>> from relax.schema import EndSection
    >>> field_names(EndSection), field_names(float)
    ({'soc_min'}, set())
    """
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return set(annotation.model_fields)
    return set()


def with_overrides(
    document: Mapping[str, Any],
    overrides: Mapping[str, object],
    model: type[BaseModel],
    sections: Mapping[str, Iterable[str]] | None = None,
) -> tuple[dict[str, Any], dict[str, tuple[str, str]]]:
    """Return a copy of a document with dotted keys set, and which fields were set.

    Parameters
    ----------
    document : mapping
        As read from TOML.
    overrides : mapping of str to object
        ``name``, ``section.name``, or ``list.NAME.field`` for an entry of a list
        of named tables; ``NAME`` is its name, else its 1-based index.
    model : type
        Names that exist.
    sections : mapping, optional
        Names that exist in sections the model leaves open.

    Returns
    -------
    document : dict
        The changed copy.
    replaced : dict
        For :class:`Origin`: the fields set, by their name in messages.

    Raises
    ------
    InputError
        A key does not exist; says which do.

    Examples
    --------
    >>> from relax.schema import TripFile
    >>> with_overrides({"name": "a"}, {"start.soc": 0.8}, TripFile)[0]
    {'name': 'a', 'start': {'soc': 0.8}}
    """
    changed = copy.deepcopy(dict(document))
    replaced = {}
    for key, value in overrides.items():
        head, _, rest = key.partition(".")
        if head not in model.model_fields:
            raise InputError(OVERRIDE, key, value, one_of(model.model_fields, head))
        if not rest:
            changed[head] = value
            replaced[head] = (OVERRIDE, "")
            continue
        annotation = model.model_fields[head].annotation
        entry_types = get_args(annotation) if isinstance(changed.get(head, []), list) else ()
        if entry_types and field_names(entry_types[0]):
            target, index, last = _entry(changed.get(head, []), rest, key, value)
            shown, names = f"{head}.{index}.{last}", field_names(entry_types[0])
        else:
            target = changed.setdefault(head, {})
            shown, last = key, rest
            names = set((sections or {}).get(head, ())) or field_names(annotation)
        if last not in names:
            allowed = one_of(names, last, before=key[: len(key) - len(last)])
            raise InputError(OVERRIDE, key, value, allowed if names else head)
        if not isinstance(target, dict):
            raise InputError(OVERRIDE, key, target, f"{shown.rpartition('.')[0]} must be a table")
        target[last] = value
        replaced[shown] = (OVERRIDE, "")
    return changed, replaced


def _entry(entries: Sequence[Any], rest: str, key: str, value: object) -> tuple[Any, int, str]:
    """Entry of a list of named tables that ``NAME.field`` means, its index, the field."""
    name, _, last = rest.rpartition(".")
    names = [str(e.get("name")) if isinstance(e, dict) else "" for e in entries]
    if name in names:
        index = names.index(name)
    elif name.isascii() and name.isdigit() and 1 <= int(name) <= len(entries):
        index = int(name) - 1
    else:
        head = key.partition(".")[0]
        allowed = one_of(names, name, f"{head}.", f".{last}")
        raise InputError(OVERRIDE, key, value, allowed if names else f"this trip has no {head}")
    return entries[index], index + 1, last
