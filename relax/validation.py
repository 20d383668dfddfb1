"""Owns checking a document against its schema, with one readable sentence per failure.

Pydantic's errors name the branches of unions and count from 0; here they become the
field as the file's author knows it. Knows nothing of what the fields mean.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from relax.document import Origin, field_names, one_of

__all__ = ["validate"]

M = TypeVar("M", bound=BaseModel)
Path = tuple[int | str, ...]

EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a table",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "missing": "a full pair",
    "model_type": "a table",
    "string_type": "a string",
    "string_pattern_mismatch": "a string without control characters",
    "string_too_short": "a string that is not empty",
    "tuple_type": "a pair",
}
"""What to say for a pydantic error type; other types say their own message."""


UNKNOWN = "extra_forbidden"
"""What pydantic calls a key that does not exist."""


def validate(model: type[M], document: Mapping[str, Any], origin: Origin) -> M:
    """Return the document as a model.

    Raises
    ------
    InputError
        The first problem, and how many fields have more. Unknown keys come first: a section or
        field that is missing is often one whose name is misspelt.

    Examples
    --------
    >>> from relax.schema import TripFile
    >>> validate(TripFile, {"name": 3}, Origin("trip.toml"))
    Traceback (most recent call last):
        ...
    relax.errors.InputError: trip.toml: name: 3; allowed: a string: name for reports (and 6 more...
    """
    text = json.dumps(document, default=_plain)
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        problems = _problems(model, json.loads(text), error)
        name, value, allowed = problems[0]  # an unknown key explains what is missing
        more = len({p[0] for p in problems}) - 1
        if more:
            allowed += f" (and {more} more problem{'s' if more > 1 else ''})"
        raise origin.error(name, value, allowed) from error


def _plain(value: Any) -> object:
    """Numbers of numpy as numbers; anything else TOML can hold (dates) as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _problems(
    model: type[BaseModel], document: Mapping[str, Any], error: ValidationError
) -> list[tuple[str, object, str]]:
    """Field, value and allowed phrase of every problem, each union reduced to one branch."""
    located = [(e, *_path(document, e["loc"], e["type"])) for e in error.errors()]
    branches: dict[Path, dict[str, list[str]]] = {}
    for e, path, union, tag in located:
        if union is not None:
            kind = "shape" if path == union else e["type"]
            branches.setdefault(union, {}).setdefault(tag, []).append(kind)
    chosen = {union: _best(kinds) for union, kinds in branches.items()}
    problems = []
    for e, path, union, tag in sorted(located, key=lambda each: each[0]["type"] != UNKNOWN):
        if union is not None and tag != chosen[union]:
            continue
        owner, description = _owner(model, path, tag)
        suffix = f": {description}" if description else ""
        value: object = e["input"]
        if e["type"] == UNKNOWN:
            allowed = one_of(owner.model_fields, path[-1]) if owner else "no more keys"
        elif e["type"] == "missing" and isinstance(e["loc"][-1], str):
            value, allowed = None, "required" + suffix
        elif union == path and description:
            allowed = description  # no branch fits: the description names them all
        else:
            said = e["msg"].removeprefix("Input should be ")
            if e["type"] == "too_short":
                said = f"at least {e['ctx']['min_length']} entries"
            allowed = EXPECTED.get(e["type"], said) + suffix
        problems.append((_shown(document, path), value, allowed))
    return problems


def _best(branches: Mapping[str, Sequence[str]]) -> str:
    """Branch of a union that fits best, by the kinds of its errors."""

    def misfit(tag: str) -> tuple[bool, int, int]:
        kinds = branches[tag]
        names = sum(kind in ("missing", "extra_forbidden") for kind in kinds)
        return "shape" in kinds, names, len(kinds)

    return min(branches, key=misfit)


def _path(
    document: object, location: Sequence[int | str], kind: str
) -> tuple[Path, Path | None, str]:
    """Location in the document; where the first union on the way is, and its branch's tag."""
    path: list[int | str] = []
    node = document
    union, tag = None, ""
    for i, part in enumerate(location):
        if isinstance(node, Mapping) and part in node:
            node = node[part]
        elif isinstance(node, list | tuple) and isinstance(part, int) and part < len(node):
            node = node[part]
        elif not (isinstance(node, Mapping) and kind == "missing" and i == len(location) - 1):
            if isinstance(part, str) and union is None:
                union, tag = tuple(path), part
            continue
        path.append(part)
    return tuple(path), union, tag


def _owner(
    model: type[BaseModel], path: Sequence[int | str], tag: str
) -> tuple[type[BaseModel] | None, str | None]:
    """Model that holds the end of a path, and the description of the field on the way."""
    owner: type[BaseModel] | None = model
    description = None
    for position, part in enumerate(path):
        if owner is None or isinstance(part, int):
            continue
        if part not in owner.model_fields:
            return owner, None
        spec = owner.model_fields[part]
        description = spec.description
        if position < len(path) - 1:
            inner = [a for a in (spec.annotation, *get_args(spec.annotation)) if field_names(a)]
            owner = next((a for a in inner if a.__name__ == tag), inner[0] if inner else None)
    return owner, description


def _shown(document: object, path: Sequence[int | str]) -> str:
    """Dotted name with 1-based indices; the name of a named list entry is added."""
    node: Any = document
    named = ""
    for part in path:
        node = node[part] if not isinstance(node, Mapping) else node.get(part)
        if (
            isinstance(part, int)
            and isinstance(node, Mapping)
            and isinstance(node.get("name"), str)
        ):
            named = f" ({node['name']!r})"
    return ".".join(str(p + 1) if isinstance(p, int) else p for p in path) + named
