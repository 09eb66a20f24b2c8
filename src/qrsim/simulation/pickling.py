"""Pickles of objects with classes in files of a user: another process loads the files first."""

from __future__ import annotations

import pickle
from typing import Any

import jax

from qrsim.core.structure import kinds
from qrsim.files.code import FileModules, files_of, load_files


def with_files(item: object, tree: object, protocol: int | None) -> tuple[object, ...] | None:
    """Return what ``__reduce_ex__`` returns for an object with classes of users' files in ``tree``; None if there are
    none.

    Args:
        item: the object, with ``__getstate__`` and ``__setstate__``.
        tree: PyTree of records whose classes may be from files.
        protocol: of the pickle.
    """
    files = files_of(kinds(jax.tree.structure(tree)))
    # As bytes, so that nothing of them is read before the files are loaded.
    return (_unpickled, (files, type(item), pickle.dumps(item.__getstate__(), protocol))) if files else None


def _unpickled(files: FileModules, kind: Any, kept: bytes) -> object:
    """Import the users' files that define an object's classes, and return the unpickled object."""
    load_files(files)
    item = kind.__new__(kind)
    item.__setstate__(pickle.loads(kept))
    return item
