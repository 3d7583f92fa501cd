"""Types of the compiled module; built from hd_control/cpp/joint_laws_module.cpp."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

class _Step(Protocol):
    def __call__(
        self,
        params: _Array,
        state: _Array,
        sample: _Array,
        reference: _Array,
        output: _Array,
        new_state: _Array,
        joints: int,
        dt: float,
    ) -> None: ...

BLOCKS: dict[str, list[tuple[str, int, str, str]]]
manifold_step: _Step
manifold_chain_step: _Step
feedback_step: _Step
feedback_chain_step: _Step
