"""`physkin doctor`: what it finds in this installation, and in ones that are made to be broken."""

import types

import pytest

from physkin_core.cli import main
from physkin_core.doctor import doctor, installation
from physkin_core.extras import EXTRAS, install_command
from physkin_core.runtime.evaluator import supported_instruction_sets

READ_MODELS = installation._models


def found(look):
    """Findings by subject."""
    return {finding.subject: finding for finding in look()}


@pytest.fixture
def quick(monkeypatch):
    """Only what is there, without reading models and motions and draping a frame."""
    monkeypatch.setattr(installation, "_frame", lambda: "draped")
    for files in ("_models", "_motions"):
        monkeypatch.setattr(installation, files, lambda: "read")
    monkeypatch.setattr(doctor, "DOCTORS", {"physkin_core.doctor.installation": ()})


def test_this_installation_works(capsys, monkeypatch):
    """A real frame, files read, nothing broken; a remedy beneath whatever is not good."""
    monkeypatch.setattr(doctor, "DOCTORS", {"physkin_core.doctor.installation": ()})
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    subjects = ["physkin", "evaluator", "garment models", "motions", "a frame", *(f"[{extra}]" for extra in EXTRAS)]
    assert [subject for subject in subjects if f"  {subject} " not in printed] == []
    assert "tshirt" in printed and supported_instruction_sets()[-1] in printed and "broken" not in printed
    assert printed.count("note  ") == printed.count("-> ")


def test_damaged_model_is_broken(quick, monkeypatch, tmp_path, capsys):
    """Its error is told with what to do, the rest is looked at all the same, and the exit status is 1."""
    (tmp_path / "tshirt.safetensors").write_bytes(b"damaged")
    monkeypatch.setattr(installation, "_models", READ_MODELS)
    monkeypatch.setattr("physkin_core.model.model_file.MODELS_PATH", tmp_path)
    assert main(["doctor"]) == 1
    lines = capsys.readouterr().out.splitlines()
    (told,) = [k for k, line in enumerate(lines) if line.startswith("broken")]
    assert "garment models" in lines[told] and "it cannot be read as safetensors" in lines[told]
    assert "pip install --force-reinstall" in lines[told + 1]
    assert any("motions" in line for line in lines[told:]) and lines[-1] == "1 broken"


def test_instruction_set_that_is_not_there(monkeypatch):
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "sse9")
    finding = installation._instruction_set()
    assert finding.state == "broken" and "PHYSKIN_NATIVE_ISA=sse9" in finding.found and "unset" in finding.remedy
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "baseline")
    finding = installation._instruction_set()
    assert finding.state == "good" and "baseline" in finding.found


def test_evaluators_that_differ_are_broken(monkeypatch):
    """More than precision explains."""
    monkeypatch.setattr(installation, "AGREEMENT", 1e-9)
    with pytest.raises(ValueError, match="differ by .* mm, allowed: 1e-06 mm"):
        installation._frame()


def test_missing_parts_are_no_fault(quick, monkeypatch):
    """No extra is needed; each says how to get it."""
    monkeypatch.setattr(installation, "find_spec", lambda name: None if name in ("pxr", "av") else types)
    findings = found(installation.look)
    assert findings["[usd]"].found == "not installed" and findings["[view]"].found == "lacks av"
    assert findings["[usd]"].remedy == install_command("usd") and findings["[ros]"].state == "good"
    assert not any(finding.state == "broken" for finding in findings.values())


def test_part_that_does_not_import_is_broken(quick, monkeypatch, capsys):
    """An installation that is not whole raises anything; it is told like the rest."""
    monkeypatch.setitem(doctor.DOCTORS, "physkin_core.doctor.nosuch", ())
    assert main(["doctor"]) == 1
    assert "broken  physkin_core    ModuleNotFoundError: No module named" in capsys.readouterr().out
    monkeypatch.setitem(doctor.DOCTORS, "physkin_core.doctor.nosuch", ("no_such_package",))
    assert main(["doctor"]) == 0
