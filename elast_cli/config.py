"""Configuration: strict pydantic models, and YAML that is only ever data.

A YAML file here is untrusted text: it can hold mappings with string keys, lists, strings, finite
numbers, booleans and null, and nothing else.
"""

from __future__ import annotations

import io
import json
import math
import typing
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent

from elast_cli.errors import ConfigError, ElastError, suggestion
from elast_cli.files import one_line, read_regular

MAX_DEPTH = 32
MAX_NODES = 20_000  # the pure-Python parser reads some 10,000 nodes a second


class StrictModel(BaseModel):
    """An immutable record that refuses unknown keys and silent type conversions."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)
JsonDict = dict[str, JsonValue]


def read_yaml(
    path: Path, *, error: type[ElastError] = ConfigError, max_bytes: int = 1 << 20
) -> dict[str, object]:
    """The mapping in a YAML file; an empty file is an empty mapping.

    Raises:
        MissingInputError: there is no such file.
        error: it is no regular file, too big, not UTF-8, or not plain data; one line naming it.
    """
    return parse_yaml(read_regular(path, error=error, max_bytes=max_bytes), str(path), error=error)


def parse_yaml(
    content: bytes, where: str, *, error: type[ElastError] = ConfigError
) -> dict[str, object]:
    """The mapping that `content` holds; `where` names its source in errors."""
    try:
        text = content.decode("utf-8")
        _refuse_unsafe(text)
        data = YAML(typ="safe", pure=True).load(text)
        data = {} if data is None else data
        _refuse_unplain(data)
        if not isinstance(data, dict):
            raise ValueError(f"expected keys and values at the top, got {type(data).__name__}")
    except UnicodeDecodeError as reason:
        raise error(f"{where}: not UTF-8 text (byte {reason.start})") from None
    except MarkedYAMLError as reason:
        line = f"line {reason.problem_mark.line + 1}: " if reason.problem_mark else ""
        raise error(f"{where}: {line}{one_line(reason.problem or reason.context)}") from None
    except (YAMLError, ValueError) as reason:
        raise error(f"{where}: {one_line(reason)}") from None
    return data


def dump_yaml(data: object) -> str:
    """Canonical YAML of plain data: sorted keys, block style, one value per line.

    Raises:
        ValueError: `data` holds something that `read_yaml` would refuse.
    """
    _refuse_unplain(data)
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.allow_unicode = False  # else some line separators do not come back
    yaml.width = 1 << 30
    out = io.StringIO()
    yaml.dump(_sorted(data), out)
    return out.getvalue()


def validate(
    model: type[Model],
    data: object,
    *,
    where: str,
    at: str = "",
    error: type[ElastError] = ConfigError,
) -> Model:
    """`data` (plain, as read from YAML) as a `model`; `where` names its source in errors.

    `at` is the key under which the source has it, if that is not the top.

    Raises:
        error: one line with the field, the value and what is allowed.
    """
    try:
        # JSON mode: lists become tuples and strings enums, and all else stays strict
        return model.model_validate_json(json.dumps(data))
    except ValidationError as failure:
        details = failure.errors(include_url=False)
        first = details[0]
        loc = tuple(first["loc"])
        field = ".".join(map(str, (at, *loc) if at else loc)) or "top level"
        if first["type"] == "extra_forbidden":
            reason = f"unknown key{_key_hint(model, loc)}"
        elif first["type"] == "missing":
            reason = "required key is missing"
        else:
            message = first["msg"].removeprefix("Value error, ")
            reason = f"{message}, got {_short(first['input'])}"
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise error(one_line(f"{where}: {field}: {reason}{more}")) from None


def _refuse_unsafe(text: str) -> None:
    """Raise ValueError at the first alias, anchor, tag or too deep or late node, building none."""
    depth = nodes = 0
    for event in YAML(typ="safe", pure=True).parse(text):
        line = event.start_mark.line + 1
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None):
            raise ValueError(f"line {line}: anchors and aliases are not allowed")
        if getattr(event, "tag", None):
            raise ValueError(f"line {line}: tags are not allowed")
        depth += isinstance(event, CollectionStartEvent)
        depth -= isinstance(event, CollectionEndEvent)
        nodes += isinstance(event, NodeEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"line {line}: nested deeper than {MAX_DEPTH}")
        if nodes > MAX_NODES:
            raise ValueError(f"line {line}: more than {MAX_NODES} values")


def _refuse_unplain(data: object, at: str = "") -> None:
    """Raise ValueError naming the first key or value that is not plain data."""
    if isinstance(data, dict):
        for key, value in data.items():
            if not isinstance(key, str):
                raise ValueError(f"{at or 'top level'}: key {_short(key)} is not a string")
            _refuse_unplain(value, f"{at}.{key}" if at else key)
    elif isinstance(data, list):
        for position, value in enumerate(data):
            _refuse_unplain(value, f"{at}[{position}]")
    elif isinstance(data, float) and not math.isfinite(data):
        raise ValueError(f"{at}: {data} is not a finite number")
    elif isinstance(data, int) and data.bit_length() > 64:
        raise ValueError(f"{at}: a number of more than 64 bits")
    elif isinstance(data, str) and not data.isprintable() and _has_surrogates(data):
        raise ValueError(f"{at}: not valid Unicode text")
    elif not (data is None or isinstance(data, bool | int | float | str)):
        raise ValueError(f"{at}: {_short(data)} is not plain data (quote it to make it a string)")


def _has_surrogates(text: str) -> bool:
    return any("\ud800" <= letter <= "\udfff" for letter in text)


def _sorted(data: object) -> object:
    if isinstance(data, dict):
        return {key: _sorted(data[key]) for key in sorted(data)}
    return [_sorted(value) for value in data] if isinstance(data, list) else data


def _key_hint(model: type[BaseModel], loc: tuple[int | str, ...]) -> str:
    """Closest and allowed keys where the unknown key `loc[-1]` stands."""
    holder: type[BaseModel] | None = model
    for part in loc[:-1]:
        if isinstance(part, int) or holder is None:
            continue
        field = holder.model_fields.get(part)
        holder = _model_in(field.annotation) if field else holder
    if holder is None:
        return ""
    allowed = sorted(holder.model_fields)
    return f"{suggestion(str(loc[-1]), allowed)}; allowed: {', '.join(allowed)}"


def _model_in(annotation: object) -> type[BaseModel] | None:
    """The first pydantic model inside a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_model_in(part) for part in typing.get_args(annotation))
    return next((model for model in found if model), None)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
