"""How many numbers a vector holds, by the processor."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.engine.by_llvm import mode_of, mode_of_many
from qrsim.engine.llvm import Mode, compiler


@pytest.mark.parametrize(
    ("features", "lanes"),
    [({"avx": True, "avx512f": True}, 16), ({"avx": True, "avx2": True}, 8), ({"neon": True}, 16)],
)
def test_vectors_are_shorter_without_avx_512(features, lanes, monkeypatch):
    """AVX has 16 registers of 8 single-precision numbers, AVX-512 has 32 of 16."""
    compiler.vector_bytes.cache_clear()
    monkeypatch.setattr(compiler, "_cpu_features", lambda: features)
    try:
        assert mode_of_many(100, 1, np.dtype(np.float32)) == Mode(lanes, side_by_side=True)
        assert mode_of_many(100, 1, np.dtype(np.float64)) == Mode(lanes // 2, side_by_side=True)
        assert mode_of(100, np.dtype(np.float32)) == Mode(lanes, side_by_side=False)
        assert mode_of(3, np.dtype(np.float32)) == Mode(lanes // 2, side_by_side=False)
    finally:
        compiler.vector_bytes.cache_clear()
