"""Named blocks of numbers: what laws read and return.

Every parameter set, state, sample and output of a law is one contiguous float64 array with named fields. The compiled
laws declare the fields (`hd_control/cpp/blocks.hpp`); this module gives them names in Python. A block costs nothing to
copy, compare bit for bit, publish for introspection or store.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hd_control.core.arrays import FloatArray


@dataclass(frozen=True)
class Field:
    """One named field: `per_joint` numbers for every joint, or a single number when `per_joint` is 0."""

    name: str
    per_joint: int
    unit: str
    meaning: str

    def shape(self, joints: int) -> tuple[int, ...]:
        """Shape of the field's view: (), (joints,) or (joints, per_joint)."""
        if self.per_joint == 0:
            return ()
        return (joints,) if self.per_joint == 1 else (joints, self.per_joint)


@dataclass(frozen=True)
class Layout:
    """Where each field of a block lies, for a given number of joints."""

    name: str
    fields: tuple[Field, ...]
    joints: int

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Field name to the slice of the flat array."""
        found, start = {}, 0
        for field in self.fields:
            size = max(1, field.per_joint * self.joints) if field.per_joint else 1
            found[field.name] = slice(start, start + size)
            start += size
        return found

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Field name to the shape of its view."""
        return {field.name: field.shape(self.joints) for field in self.fields}

    @cached_property
    def size(self) -> int:
        """Numbers in the flat array."""
        return max((part.stop for part in self.slices.values()), default=0)

    def zeros(self) -> Block:
        """A block of zeros."""
        return Block(self, np.zeros(self.size))

    def pack(self, values: Mapping[str, ArrayLike]) -> Block:
        """A block with every field given. Raises KeyError for a missing field, ValueError for a wrong shape."""
        block = self.zeros()
        for field in self.fields:
            block.view(field.name)[...] = values[field.name]
        return block

    def element_names(self, joint_names: Sequence[str]) -> list[str]:
        """One name per number, `field`, `field/joint` or `field/joint/index`, in the order of the flat array."""
        names: list[str] = []
        for field in self.fields:
            if field.per_joint == 0:
                names.append(field.name)
            elif field.per_joint == 1:
                names.extend(f"{field.name}/{joint}" for joint in joint_names)
            else:
                names.extend(f"{field.name}/{joint}/{i}" for joint in joint_names for i in range(field.per_joint))
        return names


class Block:
    """One array seen through a layout: `block.joint_position` is a view, assigning to it writes the array."""

    __slots__ = ("array", "layout")
    array: FloatArray
    layout: Layout

    def __init__(self, layout: Layout, array: FloatArray) -> None:
        object.__setattr__(self, "layout", layout)
        object.__setattr__(self, "array", array)

    def view(self, name: str) -> FloatArray:
        """The field's numbers, shaped (), (joints,) or (joints, per_joint); shares memory with the block."""
        layout = self.layout
        return self.array[layout.slices[name]].reshape(layout.shapes[name])

    def __getattr__(self, name: str) -> FloatArray:
        try:
            return self.view(name)
        except KeyError:
            raise AttributeError(f"{self.layout.name} has no field {name!r}") from None

    def __setattr__(self, name: str, value: ArrayLike) -> None:
        if name not in self.layout.slices:
            raise AttributeError(f"{self.layout.name} has no field {name!r}")
        self.view(name)[...] = value

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.layout.joints

    def copy(self) -> Block:
        """An independent block with the same numbers."""
        return Block(self.layout, self.array.copy())

    def as_dict(self) -> dict[str, FloatArray]:
        """Every field by name, as views."""
        return {field.name: self.view(field.name) for field in self.layout.fields}

    def __reduce__(self) -> tuple[Any, ...]:
        return Block, (self.layout, self.array)

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value!r}" for name, value in self.as_dict().items())
        return f"{self.layout.name}({inside})"


@lru_cache(maxsize=256)
def _layout(name: str, fields: tuple[Field, ...], joints: int) -> Layout:
    return Layout(name, fields, joints)


def layout_of(name: str, fields: Iterable[tuple[str, int, str, str]], joints: int) -> Layout:
    """The layout of a compiled block. `fields` is the extension module's list of (name, per_joint, unit, meaning)."""
    return _layout(name, tuple(Field(*field) for field in fields), joints)
