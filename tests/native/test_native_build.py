"""The evaluator as a C++ library: builds without Python, allocates nothing per frame, stays in bounds."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from native_library import NATIVE, SANITIZERS, build_library, build_program

HERE = Path(__file__).parent
AARCH64 = ("-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=aarch64")


def run(program, *arguments, launcher=()):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PHYSKIN_", "ASAN_", "UBSAN_"))}
    result = subprocess.run([*launcher, program, *arguments], capture_output=True, text=True, env=environment)
    assert "ERROR" not in result.stderr and "runtime error" not in result.stderr, result.stderr
    return result


def test_a_frame_allocates_nothing(library):
    """On every instruction set of this CPU, in every precision, for garments of odd sizes, alone and in a batch."""
    result = run(build_program(library, HERE / "frame_test.cpp"))
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


def test_frames_stay_in_bounds(sanitized_library):
    """Address and undefined-behaviour sanitizers over every instruction set and odd sizes."""
    assert run(build_program(sanitized_library, HERE / "frame_test.cpp", "c++", *SANITIZERS)).stdout


def test_damaged_files_stay_in_bounds(sanitized_library, small_bound_file):
    """Bound garment files with numbers, names and offsets changed are refused, or their frames are computed."""
    program = build_program(sanitized_library, HERE / "bound_file_fuzz.cpp", "c++", *SANITIZERS)
    result = run(program, small_bound_file, "1000")
    assert result.returncode == 0, result.stderr
    loaded, refused = (int(count) for count in re.findall(r"\d+", result.stdout))
    assert loaded > 50 and refused > 300  # both ways were gone


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_other_compilers_and_many_damaged_files(compiler, small_bound_file, tmp_path):
    """Without a warning; then the two tests above, longer."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    build_library(tmp_path / "optimised", compiler)
    frames = run(build_program(tmp_path / "optimised", HERE / "frame_test.cpp", compiler))
    assert {line.split()[2] for line in frames.stdout.splitlines()} == {"0"}
    library = build_library(tmp_path / "sanitized", compiler, *SANITIZERS)
    assert run(build_program(library, HERE / "frame_test.cpp", compiler, *SANITIZERS)).stdout
    program = build_program(library, HERE / "bound_file_fuzz.cpp", compiler, *SANITIZERS)
    assert run(program, small_bound_file, "30000").returncode == 0


@pytest.mark.slow
def test_aarch64_under_qemu(small_bound_file, tmp_path):
    """The frame test and damaged files on another architecture: its own width, its own arithmetic of int8."""
    compiler, qemu = "aarch64-linux-gnu-g++", shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
    if shutil.which(compiler) is None or qemu is None:
        pytest.skip("needs g++-aarch64-linux-gnu and qemu-user")
    library = build_library(tmp_path, compiler, options=AARCH64)
    launcher = (qemu, "-L", "/usr/aarch64-linux-gnu")
    frames = run(build_program(library, HERE / "frame_test.cpp", compiler), launcher=launcher)
    assert frames.returncode == 0, frames.stderr
    assert {line.split()[0] for line in frames.stdout.splitlines()} == {"baseline"}
    assert {line.split()[2] for line in frames.stdout.splitlines()} == {"0"}
    program = build_program(library, HERE / "bound_file_fuzz.cpp", compiler)
    assert run(program, small_bound_file, "3000", launcher=launcher).returncode == 0
