"""Types of the compiled record scanner (`cpp/records_module.cpp`)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

def scan(buffer: bytes | bytearray | memoryview, start: int, record_cap: int, max_messages: int) -> dict[str, Any]: ...
def match(
    buffer: bytes | bytearray | memoryview,
    offsets: NDArray[np.int64],
    lengths: NDArray[np.int64],
    fixed: bytes,
    mask: bytes,
    surplus: int,
) -> NDArray[np.bool_]: ...
def take(
    buffer: bytes | bytearray | memoryview, offsets: NDArray[np.int64], at: int, width: int
) -> NDArray[np.uint8]: ...
