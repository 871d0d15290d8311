"""What `physkin doctor` says of torch and Warp."""

import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'physkin[training]'")
pytest.importorskip("warp", reason="needs Warp: pip install 'physkin[training]'")
doctor = pytest.importorskip("physkin_training.doctor", reason="colcon leaves training out")


def test_gpu_is_told_or_how_to_get_one():
    """On this machine, whichever it is."""
    findings = {finding.subject: finding for finding in doctor.look()}
    assert findings.keys() == {"torch", "warp"} and torch.__version__ in findings["torch"].found
    wanted = "good" if torch.cuda.is_available() else "note"
    assert findings["torch"].state == wanted and bool(findings["torch"].remedy) == (wanted == "note")


def test_warp_that_does_not_see_torch_s_gpu_is_broken(monkeypatch):
    """Training would stop at its first step."""
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    monkeypatch.setattr("torch.cuda.get_device_name", lambda index: "GPU")
    monkeypatch.setattr("warp.get_cuda_devices", list)
    assert [finding.state for finding in doctor.look()] == ["good", "broken"]
