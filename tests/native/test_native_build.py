"""The evaluator as a C++ library: builds without Python, allocates nothing per frame, stays in bounds."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

NATIVE = Path(__file__).parents[2] / "native"
FRAME_TEST = Path(__file__).with_name("frame_test.cpp")


def build(folder, compiler="c++", *flags):
    """Builds the library without its binding and the test program on it; returns the program."""
    configure = ["cmake", "-S", NATIVE, "-B", folder, "-DPHYSKIN_PYTHON_MODULE=OFF", f"-DCMAKE_CXX_COMPILER={compiler}"]
    subprocess.run([*configure, f"-DCMAKE_CXX_FLAGS={' '.join(flags)}"], check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=subprocess.DEVNULL)
    program = folder / "frame_test"
    command = [compiler, "-std=c++17", "-O1", *flags, "-I", NATIVE / "src", FRAME_TEST, "-o", program]
    subprocess.run([*command, folder / "libphyskin_evaluator.a"], check=True)
    return program


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("native")
    build(folder)
    return folder


def test_a_frame_allocates_nothing(library):
    """On every instruction set of this CPU, in every precision, for garments of odd sizes."""
    result = subprocess.run([library / "frame_test"], capture_output=True, text=True)
    if result.returncode == 1:
        pytest.skip("counting allocations needs glibc")
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert len(lines) >= 3 * 12
    assert [line for line in lines if line.split()[2] != "0"] == []


def test_kernels_define_no_shared_inline_functions(library):
    """A weak symbol of a unit compiled for AVX-512 could be the copy that the linker keeps for everyone."""
    objects = list(library.glob("**/kernel_unit.cpp.o"))
    assert objects
    for kernel_unit in objects:
        symbols = subprocess.run(["nm", "--defined-only", kernel_unit], capture_output=True, text=True, check=True)
        kinds = {line.split()[-1]: line.split()[-2] for line in symbols.stdout.splitlines()}
        assert [name for name, kind in kinds.items() if kind in "WVu" and "physkin" not in name] == []
        assert any(kind in "BDRr" for kind in kinds.values())  # the kernel table itself: nm did list symbols


def test_sources_keep_their_promises():
    """Python only in the binding; no flag that ties the build to one machine or relaxes arithmetic."""
    for source in (NATIVE / "src").iterdir():
        if source.name != "binding.cpp":
            text = source.read_text()
            assert "Python.h" not in text and "nanobind" not in text, source
    flags = (NATIVE / "CMakeLists.txt").read_text()
    assert "-march=native" not in flags and "-ffast-math" not in flags
    assert (NATIVE / "COLCON_IGNORE").exists()


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_frames_stay_in_bounds(compiler, tmp_path):
    """Address and undefined-behaviour sanitizers over every instruction set and odd sizes."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    program = build(tmp_path, compiler, "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
    result = subprocess.run([program], capture_output=True, text=True, env={**os.environ, "ASAN_OPTIONS": ""})
    assert "ERROR" not in result.stderr and "runtime error" not in result.stderr, result.stderr
