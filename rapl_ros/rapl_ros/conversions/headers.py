"""Time, headers, arrays: the parts of which messages are made."""

from array import array
from collections.abc import Iterable

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Header

from rapl_ros.wire import (
    JoinKey,
)

SECOND_NS = 1_000_000_000


def time_to_ros(stamp_ns: int) -> Time:
    """Nanoseconds to a stamp."""
    sec, nanosec = divmod(int(stamp_ns), SECOND_NS)
    return Time(sec=sec, nanosec=nanosec)


def time_from_ros(stamp: Time) -> int:
    """A stamp to nanoseconds."""
    return stamp.sec * SECOND_NS + stamp.nanosec


def header_to_ros(key: JoinKey) -> Header:
    """Join key to the header that it names."""
    return Header(stamp=time_to_ros(key.stamp_ns), frame_id=key.frame_id)


def key_from_ros(header: Header) -> JoinKey:
    """Header to the key by which image, state and embedding are joined."""
    return JoinKey(header.frame_id, time_from_ros(header.stamp))


def floats_to_ros(values: ArrayLike) -> "array[float]":
    """Any real array, row-major, to float64[]."""
    sequence = array("d")
    sequence.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return sequence


def singles_to_ros(values: ArrayLike) -> "array[float]":
    """Any real array, row-major, to float32[]."""
    sequence = array("f")
    sequence.frombytes(np.ascontiguousarray(values, dtype=np.float32).tobytes())
    return sequence


def bytes_to_ros(values: NDArray[np.uint8]) -> "array[int]":
    """A uint8 array, row-major, to uint8[]."""
    sequence = array("B")
    sequence.frombytes(np.ascontiguousarray(values).tobytes())
    return sequence


def counts_to_ros(values: Iterable[int]) -> "array[int]":
    return array("H", [int(value) for value in values])
