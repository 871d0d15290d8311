"""The wheel holds every file of the packages, the native module, and asks for nothing heavy."""

import json
import shutil
import subprocess
import sys
import tomllib
import zipfile

import pytest

from import_graph import INSTALLED, PACKAGES, ROOT

SHIPPED = {name: PACKAGES[name] for name in INSTALLED}
NOT_SHIPPED = ("__pycache__", "CMakeLists.txt", "package.xml", ".so")
HEAVY = ("torch", "warp", "anny", "rclpy", "mitsuba")


def files():
    """Of the packages: (package, path below its folder, path below the root)."""
    for package, folder in SHIPPED.items():
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and not any(part in str(path) for part in NOT_SHIPPED):
                yield package, path.relative_to(ROOT / folder), path.relative_to(ROOT)


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.mark.skipif(not (ROOT / ".git").exists() or shutil.which("git") is None, reason="needs a clone and git")
def test_no_file_is_left_out_of_the_build(project):
    """A wheel takes what lies in its packages, but for what git ignores: an asset of such a name would go missing."""
    assert project["tool"]["scikit-build"]["wheel"]["packages"] == list(SHIPPED.values())
    names = "\n".join(str(path) for _, _, path in files())
    command = ["git", "check-ignore", "--no-index", "--stdin"]
    ignored = subprocess.run(command, input=names, capture_output=True, text=True, cwd=ROOT)
    assert ignored.returncode == 1, ignored.stdout + ignored.stderr  # 1: none


def test_plain_install_asks_for_nothing_heavy(project):
    wanted = project["project"]["dependencies"]
    assert wanted and [line for line in wanted for heavy in HEAVY if heavy in line.lower()] == []


def test_every_python_that_is_promised_is_tested_and_built_for(project):
    versions = [line.rsplit(" ", 1)[1] for line in project["project"]["classifiers"] if " :: Python :: 3." in line]
    built = project["tool"]["cibuildwheel"]["build"].split()
    assert built == [f"cp{version.replace('.', '')}-manylinux_*" for version in versions] and versions
    assert f"python: {json.dumps(versions)}" in (ROOT / ".github" / "workflows" / "ci.yml").read_text()


@pytest.mark.slow
def test_wheel_holds_every_file(tmp_path):
    """Data files too: a model or a map that is left out is missed only on the user's machine."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", tmp_path, ROOT]
    subprocess.run(command, check=True)
    (path,) = tmp_path.glob("physkin-*.whl")
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
    wanted = {f"{package}/{path}" for package, path, _ in files()}
    assert {f"{package}/__init__.py" for package in SHIPPED} <= wanted
    assert wanted - names == set()
    code = {name for name in names if name.endswith(".py") and ".data/" not in name}  # examples are data
    assert {name.split("/")[0] for name in code} == set(SHIPPED)
    assert any(name.startswith("physkin_core/_native.") for name in names)
    assert "physkin_core/libphyskin_c.so" in names
    page = ROOT / "build" / "web" / "page"  # of `physkin export --web`, where `make wasm` has run
    assert {f"physkin_core/web/{path.relative_to(page)}" for path in page.rglob("*") if path.is_file()} <= names
