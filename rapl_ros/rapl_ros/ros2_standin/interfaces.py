"""Message, service and action classes and definition files by their names."""

import importlib
import os
import sys
from pathlib import Path
from typing import Any

KINDS = ("msg", "srv", "action")


def load_class(name: str, kind: str) -> Any:
    """Return the class of ``package/kind/Type`` (``package/Type`` is understood as well).

    :raises LookupError: if there is no such interface of this kind.
    """
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, kind)
    if len(parts) != 3 or parts[1] != kind:
        raise LookupError(name)
    try:
        return getattr(importlib.import_module(f"{parts[0]}.{kind}"), parts[2])
    except (AttributeError, ModuleNotFoundError, ValueError) as error:
        raise LookupError(name) from error


def definition_file(name: str) -> Path:
    """Return the file that defines ``package/kind/Type``.

    :raises LookupError: if the package or the interface is unknown, or the name malformed.
    """
    parts = name.split("/")
    if len(parts) != 3 or parts[1] not in KINDS:
        raise LookupError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    package, kind, type_name = parts
    shares = [prefix / "share" / package for prefix in _prefixes()]
    for share in shares:
        path = share / kind / f"{type_name}.{kind}"
        if path.is_file():
            return path
    if not any(share.is_dir() for share in shares):
        raise LookupError(f"Unknown package '{package}'")
    raise LookupError(f"Could not find the interface '{name}'")


def _prefixes() -> list[Path]:
    sourced = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if entry]
    return [*sourced, Path(sys.prefix)]
