"""A learned policy as an ONNX model: a runtime of others acts as NumPy does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.tasks.test_learned_c import PLAIN, SUMMING, VIEW, policy

from qrsim import cli
from qrsim.errors import UsageError
from qrsim.tasks.learned import View


@pytest.mark.parametrize("view", [VIEW, PLAIN, SUMMING], ids=["turning", "plain", "summing"])
def test_onnx_acts_as_numpy_does(view: View, tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="needs onnx")
    runtime = pytest.importorskip("onnxruntime", reason="needs onnxruntime")
    file = policy(view)
    (tmp_path / "policy.npz").write_bytes(file.content())
    assert cli.main(["export", str(tmp_path / "policy.npz"), "--format", "onnx"]) == 0
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(tmp_path / "policy.onnx", options, providers=["CPUExecutionProvider"])
    # Two vehicles by one call.
    pilot, last, rng = file.pilot(2, 0.1), np.zeros((2, view.remembered), np.float32), np.random.default_rng(6)
    for scale in (1.0, 3.0, 3.0, 100.0):
        seen = rng.normal(0.0, scale, (2, 6)).astype(np.float32)
        action, last = session.run(["action", "next_last"], {"observation": seen, "last": last})
        np.testing.assert_allclose(action, pilot.act(seen), rtol=0.0, atol=1e-6)
    np.testing.assert_array_equal(action[:, 2], 1.0)
    assert (np.abs(action[:, 0]) > 0.0).all()
    told = session.get_modelmeta().custom_metadata_map
    assert (told["task"], told["seconds"]) == ("made */ up", "0.1")
    assert told["action"] == '["pitch", "roll", "battery", "throttle"]'


def test_the_extra_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(extra: str, purpose: str, module: str) -> None:
        raise UsageError(f"{purpose} needs {module}: {extra}")

    monkeypatch.setattr("qrsim.tasks.learned_onnx.load", missing)
    (tmp_path / "policy.npz").write_bytes(policy(VIEW).content())
    assert cli.main(["export", str(tmp_path / "policy.npz"), "--format", "onnx"]) == 2
    assert capsys.readouterr().err == "error: an ONNX model needs onnx: onnx\n"
    assert not (tmp_path / "policy.onnx").exists()
