"""Messages as YAML text and back, in the form of the real ``ros2``."""

import array
import sys
from typing import Any

import numpy as np
import yaml
from rosidl_parser import definition

from rapl_ros.ros2_standin.interfaces import load_class

TRUNCATE_LENGTH = 128
"""Elements of an array or characters of a string that are shown by default."""

_SEQUENCES = (list, tuple, array.array, np.ndarray)


def to_yaml(
    message: Any,
    *,
    truncate: int | None,
    no_arr: bool = False,
    no_str: bool = False,
    flow_style: bool = False,
) -> str:
    """Return ``message`` as YAML.

    :param truncate: longest array or string shown in full; None shows everything.
    :param no_arr: show type and length of arrays in their place.
    :param no_str: show the length of strings in their place.
    """
    return yaml.dump(
        to_dict(message, truncate=truncate, no_arr=no_arr, no_str=no_str),
        allow_unicode=True,
        width=sys.maxsize,
        default_flow_style=flow_style,
        sort_keys=False,
    )


def to_dict(message: Any, *, truncate: int | None, no_arr: bool, no_str: bool) -> dict[str, Any]:
    """Return the fields of ``message`` in the order of its definition."""
    return {
        name: _plain(getattr(message, name), slot, truncate, no_arr, no_str)
        for name, slot in zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)
    }


def _plain(value: Any, slot: Any, truncate: int | None, no_arr: bool, no_str: bool) -> Any:
    """Return ``value`` in types that YAML writes plainly; ``slot`` is None inside a sequence."""
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    elif isinstance(value, str) and no_str:
        return f"<string length: <{len(value)}>>"
    if isinstance(value, str):
        return value if truncate is None or len(value) <= truncate else value[:truncate] + "..."
    if isinstance(value, _SEQUENCES):
        if no_arr and slot is not None:
            return _abbreviated(value, slot)
        cut = truncate is not None and len(value) > truncate
        shown = value[:truncate] if cut else value
        plain = [_plain(item, None, truncate, no_arr, no_str) for item in shown]
        return plain + ["..."] if cut else plain
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (bool, int, float)):
        return value
    return to_dict(value, truncate=truncate, no_arr=no_arr, no_str=no_str)


def _abbreviated(value: Any, slot: Any) -> str:
    name = _type_name(slot.value_type)
    if isinstance(slot, definition.Array):
        return f"<array type: {name}[{slot.size}]>"
    if isinstance(slot, definition.BoundedSequence):
        return f"<sequence type: {name}[{slot.maximum_size}], length: {len(value)}>"
    return f"<sequence type: {name}, length: {len(value)}>"


def _type_name(value_type: Any) -> str:
    if isinstance(value_type, definition.BasicType):
        return str(value_type.typename)
    if isinstance(value_type, definition.AbstractString):
        return "string"
    if isinstance(value_type, definition.AbstractWString):
        return "wstring"
    if isinstance(value_type, definition.NamespacedType):
        return "/".join(value_type.namespaced_name())
    return "unknown"


def fill(message: Any, values: Any) -> None:
    """Set fields of ``message`` from parsed YAML.

    :raises AttributeError: if a field does not exist.
    :raises TypeError: if a value does not fit its field.
    :raises ValueError: likewise.
    """
    if not isinstance(values, dict):
        raise TypeError(
            f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}"
        )
    slots = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    for name, value in values.items():
        present = getattr(message, name)
        setattr(message, name, _converted(present, value, slots[name]))


def _converted(present: Any, value: Any, slot: Any) -> Any:
    if isinstance(present, array.array):
        return array.array(present.typecode, value)
    if isinstance(present, np.ndarray):
        return np.array(value, dtype=present.dtype)
    if isinstance(slot, definition.AbstractNestedType):
        if not isinstance(slot.value_type, definition.NamespacedType):
            return list(value)
        item_class = load_class("/".join(slot.value_type.namespaced_name()), "msg")
        return [_filled(item_class(), item) for item in value]
    if isinstance(slot, definition.NamespacedType):
        return _filled(type(present)(), value)
    return value if type(value) is type(present) else type(present)(value)


def _filled(message: Any, values: Any) -> Any:
    fill(message, values)
    return message
