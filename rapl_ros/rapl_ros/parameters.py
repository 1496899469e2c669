"""Frozen config dataclasses of rapl_core as ROS parameters, and back.

A field's description is ``metadata["description"]``, else the docstring under the field; its range
``metadata["minimum"]`` and ``metadata["maximum"]``; its choices those of its ``Literal`` type or
``metadata["choices"]``. A nested dataclass is a dotted group. ROS has no null: ``str | None`` and
``Path | None`` use an empty string, ``float | None`` NaN.
"""

import ast
import inspect
import math
import textwrap
import types
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from rapl_core.errors import RaplError

Config = TypeVar("Config")

SCALARS: dict[type, Parameter.Type] = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
    Path: Parameter.Type.STRING,
}
ARRAYS: dict[type, Parameter.Type] = {
    bool: Parameter.Type.BOOL_ARRAY,
    int: Parameter.Type.INTEGER_ARRAY,
    float: Parameter.Type.DOUBLE_ARRAY,
    str: Parameter.Type.STRING_ARRAY,
}


class ParameterError(RaplError):
    """A parameter has a value, type or name that is not acceptable."""


@dataclass(frozen=True)
class _Field:
    """One leaf of a config: a parameter."""

    name: str
    """Dotted, with the prefix."""
    kind: type
    """bool, int, float, str or Path; of an element where ``is_array``."""
    is_array: bool
    is_optional: bool
    choices: tuple[Any, ...]
    description: str
    minimum: float | None
    maximum: float | None

    @property
    def ros_type(self) -> Parameter.Type:
        return ARRAYS[self.kind] if self.is_array else SCALARS[self.kind]

    def to_ros(self, value: Any) -> Any:
        if value is None:
            return math.nan if self.kind is float else ""
        if self.is_array:
            return [self.kind(element) for element in value]
        return str(value) if self.kind is Path else self.kind(value)

    def from_ros(self, value: Any) -> Any:
        if self.is_optional and (value == "" or (self.kind is float and math.isnan(value))):
            return None
        if self.is_array:
            return tuple(self.kind(element) for element in value)
        return self.kind(value)

    def check(self, value: Any) -> None:
        """Raise ParameterError if the ROS value is no choice or out of range."""
        for element in value if self.is_array else (value,):
            is_null = self.is_optional and element == ""
            if self.choices and element not in self.choices and not is_null:
                known = ", ".join(map(str, self.choices))
                raise ParameterError(f"parameter '{self.name}' is '{element}'; known: {known}")
            if self.kind is float and not self.is_optional and math.isnan(element):
                raise ParameterError(f"parameter '{self.name}' is nan, expected a number")
            below = self.minimum is not None and element < self.minimum
            above = self.maximum is not None and element > self.maximum
            if below or above:
                raise ParameterError(
                    f"parameter '{self.name}' is {element}, expected "
                    f"{self.minimum if self.minimum is not None else '-inf'} to "
                    f"{self.maximum if self.maximum is not None else 'inf'}"
                )

    def descriptor(self, read_only: bool) -> ParameterDescriptor:
        descriptor = ParameterDescriptor(
            name=self.name, description=self.description, read_only=read_only
        )
        if self.choices:
            known = ", ".join(map(str, self.choices))
            descriptor.additional_constraints = f"one of: {known}"
        bounded = self.minimum is not None or self.maximum is not None
        if bounded and self.kind is int:
            low = -(2**63) if self.minimum is None else int(self.minimum)
            high = 2**63 - 1 if self.maximum is None else int(self.maximum)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        elif bounded and self.kind is float and not self.is_optional:
            span = FloatingPointRange(
                from_value=-1.7e308 if self.minimum is None else float(self.minimum),
                to_value=1.7e308 if self.maximum is None else float(self.maximum),
            )
            descriptor.floating_point_range = [span]
        return descriptor


class ConfigParameters(Generic[Config]):
    """A config dataclass declared on a node.

    :param node: where to declare.
    :param defaults: the values that hold unless a launch file or the user overrides them.
    :param prefix: dotted group in which the fields stand; empty for the node's own.
    :param writable: dotted field names (without prefix) that may change at run time; the node sees
        a change by reading ``value`` again. All others are read-only.
    :param left_out: dotted field names (without prefix) that are no parameters, for the node gets
        them in another way; ``value`` has their defaults.
    :raises ParameterError: if an override has another type, is out of range or is refused by the
        dataclass itself.
    """

    def __init__(
        self,
        node: Node,
        defaults: Config,
        prefix: str = "",
        writable: Iterable[str] = (),
        left_out: Iterable[str] = (),
    ) -> None:
        self._defaults = defaults
        self._prefix = prefix
        missing = {_join(prefix, name) for name in left_out}
        leaves = [leaf for leaf in _leaves(defaults, prefix) if leaf[0].name not in missing]
        self._fields = {field.name: field for field, _ in leaves}
        changeable = {_join(prefix, name) for name in writable}
        unknown = changeable - set(self._fields)
        if unknown:
            raise ParameterError(
                f"writable {', '.join(sorted(unknown))} not among {', '.join(self._fields)}"
            )
        values = {
            field.name: _declare(node, field, value, field.name not in changeable)
            for field, value in leaves
        }
        self._values = values
        self.value: Config = self._rebuild(values)
        """The config as the parameters stand now."""
        if changeable:
            node.add_on_set_parameters_callback(self._on_set)
            node.add_post_set_parameters_callback(self._after_set)

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        mine = {p.name: p.value for p in parameters if p.name in self._fields}
        try:
            self._rebuild(self._values | mine)
        except (RaplError, TypeError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _after_set(self, parameters: list[Parameter]) -> None:
        mine = {p.name: p.value for p in parameters if p.name in self._fields}
        if mine:
            self._values |= mine
            self.value = self._rebuild(self._values)

    def _rebuild(self, values: Mapping[str, Any]) -> Config:
        for name, field in self._fields.items():
            field.check(values[name])
        return _replaced(self._defaults, self._prefix, self._fields, values)


def declare_config(
    node: Node,
    defaults: Config,
    prefix: str = "",
    writable: Iterable[str] = (),
    left_out: Iterable[str] = (),
) -> Config:
    """Declare ``defaults`` as parameters and return the config as overridden by the user.

    For a config with writable fields keep the ``ConfigParameters`` instead.
    """
    return ConfigParameters(node, defaults, prefix, writable, left_out).value


def _declare(node: Node, field: _Field, default: Any, read_only: bool) -> Any:
    value = field.to_ros(default)
    # rclpy takes an empty list for bytes: such a parameter is declared by its type and stays unset.
    initial = field.ros_type if value == [] else value
    try:
        declared = node.declare_parameter(field.name, initial, field.descriptor(read_only))
    except InvalidParameterTypeException as error:
        raise ParameterError(
            f"parameter '{field.name}' has another type than {field.ros_type.name.lower()}: {error}"
        ) from error
    except InvalidParameterValueException as error:
        raise ParameterError(f"parameter '{field.name}' is refused: {error}") from error
    return [] if declared.value is None else declared.value


def _join(prefix: str, name: str) -> str:
    return f"{prefix}.{name}" if prefix else name


def _leaves(config: Any, prefix: str) -> Iterator[tuple[_Field, Any]]:
    """Yield every leaf of a config and its value, nested dataclasses as dotted groups."""
    if not is_dataclass(config) or isinstance(config, type):
        raise ParameterError(f"{config!r} is no instance of a dataclass")
    hints = get_type_hints(type(config))
    docs = field_docs(type(config))
    for field in fields(config):
        if not field.init:
            continue
        name, value = _join(prefix, field.name), getattr(config, field.name)
        if is_dataclass(value):
            yield from _leaves(value, name)
            continue
        kind, is_array, is_optional, choices = _kind(name, hints[field.name])
        yield (
            _Field(
                name,
                kind,
                is_array,
                is_optional,
                tuple(field.metadata.get("choices", choices)),
                field.metadata.get("description", docs.get(field.name, "")),
                field.metadata.get("minimum"),
                field.metadata.get("maximum"),
            ),
            value,
        )


def _kind(name: str, hint: Any) -> tuple[type, bool, bool, tuple[Any, ...]]:
    """Return (kind, is array, is optional, choices) of a type hint."""
    is_optional = False
    if get_origin(hint) in (Union, types.UnionType):
        inner = [arg for arg in get_args(hint) if arg is not type(None)]
        is_optional = len(inner) < len(get_args(hint))
        if len(inner) != 1 or get_origin(inner[0]) is tuple or inner[0] in (int, bool):
            raise ParameterError(f"field '{name}' of type {hint} has no form as a ROS parameter")
        hint = inner[0]
    is_array = get_origin(hint) in (tuple, list)
    if is_array:
        hint = get_args(hint)[0]
    choices: tuple[Any, ...] = ()
    if get_origin(hint) is Literal:
        choices = get_args(hint)
        hint = type(choices[0])
    if hint not in (ARRAYS if is_array else SCALARS):
        raise ParameterError(f"field '{name}' of type {hint} has no form as a ROS parameter")
    return hint, is_array, is_optional, choices


def _replaced(
    config: Any, prefix: str, leaves: Mapping[str, _Field], values: Mapping[str, Any]
) -> Any:
    changes = {}
    for field in fields(config):
        name = _join(prefix, field.name)
        if name in leaves:
            changes[field.name] = leaves[name].from_ros(values[name])
        elif is_dataclass(getattr(config, field.name)):
            changes[field.name] = _replaced(getattr(config, field.name), name, leaves, values)
    return replace(config, **changes)


def field_docs(config_type: type) -> dict[str, str]:
    """Return the docstrings that stand under the fields of a class, base classes included."""
    docs: dict[str, str] = {}
    for base in reversed(config_type.__mro__):
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
        except (OSError, TypeError):  # builtins, or a class made at run time: no source
            continue
        body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
        for field, doc in zip(body, body[1:], strict=False):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(doc, ast.Expr)
                and isinstance(doc.value, ast.Constant)
                and isinstance(doc.value.value, str)
            ):
                docs[field.target.id] = " ".join(doc.value.value.split())
    return docs
