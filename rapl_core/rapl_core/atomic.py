"""Files that are there complete or not at all."""

import os
import uuid
from contextlib import suppress
from pathlib import Path

from rapl_core.errors import RaplError


def write_atomically(
    path: Path | str,
    data: bytes | str,
    what: str = "",
    *,
    error: type[RaplError] = RaplError,
    mode: int = 0o666,
    flush: bool = True,
) -> Path:
    """Write ``data`` beside ``path``, then rename: a reader sees the old file or the new one.

    Nothing half written stays, whatever fails; any number of threads and processes may write the
    same path.

    :param data: text is written as UTF-8.
    :param what: names the content in the message, e.g. ``the curve``.
    :param error: raised when it cannot be written.
    :param mode: permissions of a new file, less the umask.
    :param flush: whether it is on disk when this returns; a cache, which may be lost, does without.
    :return: ``path``.
    :raises RaplError: if it cannot be written, as on a full disk; names the path and the reason.
    """
    path = Path(path)
    content = data.encode() if isinstance(data, str) else data
    beside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
            file.flush()
            if flush:
                os.fsync(file.fileno())
        beside.replace(path)
    except OSError as reason:
        raise error(
            f"cannot write {f'{what} ' if what else ''}{path}: {reason.strerror or reason}"
        ) from reason
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
    return path
