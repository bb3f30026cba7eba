"""Many arrays in one: each array that a compiled function takes costs a call from Python 50 ns.

A block is a record, seen as int64 words. Its first field, `layout`, has three numbers for each of the others:
the word at which it starts, its rows and its columns; a vector has one row. Python names the fields through a
NumPy record type. Compiled code numbers them, and need not be compiled again for other sizes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.numpy_support import carray
from numpy.typing import DTypeLike, NDArray

from .compiled import njit

Words = NDArray[np.int64]
_WORD = 8
"""Bytes of a word."""


def block_type(fields: Mapping[str, tuple[DTypeLike, tuple[int, ...]]]) -> np.dtype:
    """The record type of a block.

    Args:
        fields: Type and shape of each: (), (columns,) or (rows, columns).
    """
    formats = [np.dtype((np.int64, (len(fields), 3))), *(np.dtype(each) for each in fields.values())]
    words = [-(-each.itemsize // _WORD) for each in formats]
    ends = np.cumsum(words)
    return np.dtype(
        {
            "names": ["layout", *fields],
            "formats": formats,
            "offsets": list(_WORD * (ends - words)),
            "itemsize": int(_WORD * ends[-1]),
        }
    )


def zero_blocks(n: int, record: np.dtype) -> Words:
    """Blocks of zeros, (n, words), of a type that `block_type` made."""
    blocks = np.zeros(n, record)
    parts = list((record.fields or {}).values())
    for k, (field, start, *_) in enumerate(parts[1:]):
        blocks["layout"][:, k] = start // _WORD, *(1, 1, *field.shape)[-2:]
    return blocks.view(np.int64).reshape(n, record.itemsize // _WORD)


def packed(arrays: Mapping[str, NDArray[Any]]) -> Words:
    """Copies of arrays of 0 to 2 dimensions in one block, (words,), in this order."""
    record = block_type({name: (array.dtype, array.shape) for name, array in arrays.items()})
    blocks = zero_blocks(1, record)
    named = fields(blocks, record)
    for name, array in arrays.items():
        named[name] = array
    return blocks[0]


def fields(blocks: Words, record: np.dtype) -> NDArray[np.void]:
    """The records (n,) that blocks (n, words) are, in the same memory."""
    return blocks.view(record)[:, 0]


@intrinsic
def _pointer(typingctx, address):
    """An address as a pointer."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.uintp), generate


@njit
def _field(block, k):
    """Where field k of a block is."""
    return _pointer(block.ctypes.data + _WORD * block[3 * k])  # pyright: ignore[reportCallIssue]


@njit
def vector(block, k, dtype) -> NDArray[Any]:
    """Field k of a block as a vector, in compiled code; a scalar is a vector of one.

    Args:
        block: Words of a block. It has to outlive the view, which does not count as a reference to it.
        k: Number of the field, the one after the layout being 0.
        dtype: Type of the field.
    """
    return carray(_field(block, k), block[3 * k + 1] * block[3 * k + 2], dtype)


@njit
def matrix(block, k, dtype) -> NDArray[Any]:
    """Field k of a block as a matrix (rows, columns); see `vector`."""
    return carray(_field(block, k), (block[3 * k + 1], block[3 * k + 2]), dtype)
