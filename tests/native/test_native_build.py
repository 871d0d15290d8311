"""The evaluator as a C++ library: builds without Python, allocates nothing per frame, stays in bounds."""

import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from native_library import NATIVE, SANITIZERS, build_library, build_program

from physkin_core.runtime.bound_file import save_bound_outfit
from physkin_core.runtime.evaluator import supported_instruction_sets

HERE = Path(__file__).parent
ARM_COMPILER, ARM_LEVELS = "aarch64-linux-gnu-g++", ("baseline", "dotprod", "i8mm")
AARCH64 = ("-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=aarch64")


def run(program, *arguments, launcher=()):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PHYSKIN_", "ASAN_", "UBSAN_"))}
    result = subprocess.run([*launcher, program, *arguments], capture_output=True, text=True, env=environment)
    assert "ERROR" not in result.stderr and "runtime error" not in result.stderr, result.stderr
    return result


def test_sources_keep_their_promises():
    """Python only in the bindings; no flag for one machine or for relaxed arithmetic; rooms go one way."""
    rooms = {"kernels": set(), "garment": {"kernels"}, "file_format": {"outfit", "garment", "kernels"}}
    rooms |= {"evaluator": {"garment", "kernels"}, "outfit": {"evaluator", "garment", "kernels"}, "joints": set()}
    rooms |= dict.fromkeys(("separation", "sway"), {"evaluator", "garment", "kernels"})
    for source in (NATIVE / "src").rglob("*.[ch]pp"):
        text, room = source.read_text(), source.parent.name
        is_binding = room == "src" and ("binding" in source.stem or source.stem in ("python_arrays", "numpy_arrays"))
        assert is_binding or ("Python.h" not in text and "nanobind" not in text), source
        included = set(re.findall(r'#include "([a-z_]+)/', text))
        assert room == "src" or included <= rooms[room] | {room}, source
    flags = (NATIVE / "CMakeLists.txt").read_text()
    assert "-march=native" not in flags and "-ffast-math" not in flags
    assert (NATIVE / "COLCON_IGNORE").exists()


def check_kernels_define_no_shared_inline_functions(library):
    """A weak symbol of a unit compiled for AVX-512 could be the copy that the linker keeps for everyone."""
    objects = list(library.glob("**/kernel_unit.cpp.o"))
    assert objects
    for kernel_unit in objects:
        symbols = subprocess.run(["nm", "--defined-only", kernel_unit], capture_output=True, text=True, check=True)
        kinds = {line.split()[-1]: line.split()[-2] for line in symbols.stdout.splitlines()}
        assert [name for name, kind in kinds.items() if kind in "WVu" and "physkin" not in name] == []
        assert any(kind in "BDRr" for kind in kinds.values())  # the kernel table itself: nm did list symbols


@pytest.fixture
def odd_files(make_garment, tmp_path):
    """Bound files of garments of odd sizes, each alone and twice: with a fabric, most with a sway network, some with
    detail, faces, and kept out of the skin."""
    files = []
    for size in (1, 2, 3, 7, 15, 16, 17, 31, 32, 33, 64, 100):
        rng, widths = np.random.default_rng(size), (size, size)
        sizes = dict(bones=1 + size // 3, dofs=size, nodes=size, vertices=3 * size, influences=1 + size % 8)
        detail = size if size % 2 else 0
        garment = make_garment(
            rng,
            **sizes,
            pose_widths=widths,
            deformer_widths=widths,
            learnt_sway=size > 3,
            detail_nodes=detail,
            fabrics=1,
            skin_blocks=size + 5 if size % 4 < 2 else 0,
        )
        faces = rng.integers(0, 3 * size, size=(6 * size * (size % 2 == 0), 3)).astype(np.int32)
        garment = replace(garment, faces=faces)
        for times in (1, 2):
            files.append(tmp_path / f"{size}_{times}")
            names = {"names": ["g"] * times, "fabrics": [["one", "other"]] * times, "joint_names": ["j"] * size}
            save_bound_outfit([garment] * times, files[-1], **names)
    return files


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_builds_of_other_hosts(compiler, small_bound_file, odd_files, tmp_path):
    """Without a warning.

    Optimised: no frame allocates, on any instruction set, in any precision, for garments of odd sizes, alone and two
    together. With sanitizers: frames stay in bounds, and so do bound garment files that are cut off or
    changed.
    """
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    library = build_library(tmp_path / "optimised", compiler)
    check_kernels_define_no_shared_inline_functions(library)
    subprocess.run(["cmake", "--install", library, "--prefix", tmp_path], check=True, stdout=subprocess.DEVNULL)
    assert (tmp_path / "include" / "physkin.h").is_file() and list(tmp_path.glob("lib*/**/libphyskin_c.so.4"))
    frames = run(build_program(library, HERE / "frame_test.cpp", compiler), *odd_files)
    assert {line.split()[2] for line in frames.stdout.splitlines()} == {"0"}
    library = build_library(tmp_path / "sanitized", compiler, *SANITIZERS)
    assert run(build_program(library, HERE / "frame_test.cpp", compiler, *SANITIZERS), *odd_files).stdout
    program = build_program(library, HERE / "bound_file_fuzz.cpp", compiler, *SANITIZERS)
    result = run(program, small_bound_file, "10000")
    assert result.returncode == 0, result.stderr
    loaded, refused = (int(count) for count in re.findall(r"\d+", result.stdout))
    assert loaded > 1000 and refused > 1000  # both ways were gone: some 6,000 and 4,000


@pytest.fixture
def qemu():
    """Runs a program for ARM on a processor by its name."""
    found = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
    if shutil.which(ARM_COMPILER) is None or found is None:
        pytest.skip("needs g++-aarch64-linux-gnu and qemu-user-static")
    return lambda cpu, *command: run(*command, launcher=(found, "-L", "/usr/aarch64-linux-gnu", "-cpu", cpu))


@pytest.mark.parametrize("level", ARM_LEVELS)
def test_layers_on_arm(level, qemu, tmp_path):
    """Of 8-bit network weights bit for bit, on every level, what plain loops give."""
    (flags,) = re.findall(rf"isa_{level}_flags (-march.*)\)", (NATIVE / "CMakeLists.txt").read_text()) or [""]
    command = [ARM_COMPILER, "-std=c++17", "-O2", "-ffp-contract=fast", *flags.split(), f"-DPHYSKIN_ISA={level}"]
    command += ["-Wall", "-Wextra", "-Werror", "-static", "-I", NATIVE / "src", HERE / "dense_kernel_test.cpp"]
    sources = [NATIVE / "src/kernels" / name for name in ("packed_layer.cpp", "huge_pages.cpp")]
    subprocess.run([*command, *sources, "-o", tmp_path / "layers"], check=True)
    result = qemu("max", tmp_path / "layers")
    assert (result.returncode, result.stdout) == (0, "540\n"), result.stdout


@pytest.mark.slow
def test_frames_on_arm(qemu, small_bound_file, odd_files, tmp_path):
    """The frame test on processors with and without each level, and damaged files."""
    library = build_library(tmp_path, ARM_COMPILER, options=AARCH64)
    check_kernels_define_no_shared_inline_functions(library)
    program = build_program(library, HERE / "frame_test.cpp", ARM_COMPILER)
    for cpu, supported in (("cortex-a72", 1), ("neoverse-n1", 2), ("max", 3)):
        frames = qemu(cpu, program, *odd_files)
        assert frames.returncode == 0, frames.stderr
        assert {line.split()[0] for line in frames.stdout.splitlines()} == set(ARM_LEVELS[:supported])
        assert {line.split()[2] for line in frames.stdout.splitlines()} == {"0"}
    program = build_program(library, HERE / "bound_file_fuzz.cpp", ARM_COMPILER)
    assert qemu("max", program, small_bound_file, "3000").returncode == 0


@pytest.mark.slow
def test_windows(small_bound_file, tmp_path):
    """By MinGW, without a warning; under Wine the example drapes, on every instruction set."""
    compiler, wine = "x86_64-w64-mingw32-g++-posix", shutil.which("wine")
    if shutil.which(compiler) is None:
        pytest.skip("needs g++-mingw-w64-x86-64-posix")
    windows = ("-DCMAKE_SYSTEM_NAME=Windows", "-DCMAKE_SYSTEM_PROCESSOR=x86_64")
    library = build_library(tmp_path, compiler, options=(*windows, "-DCMAKE_SHARED_LINKER_FLAGS=-static"))
    program = tmp_path / "drape.exe"
    source = ("-I", NATIVE / "include", NATIVE / "examples" / "drape.c", "-L", library, "-lphyskin_c")
    subprocess.run([compiler.replace("g++", "gcc"), "-std=c99", *source, "-o", program], check=True)
    if wine is None:
        pytest.skip("built; needs wine to run it")
    for level in supported_instruction_sets():
        environment = os.environ | {
            "PHYSKIN_NATIVE_ISA": level,
            "WINEDEBUG": "-all",
            "WINEPREFIX": str(tmp_path / "wine"),
        }
        done = subprocess.run([wine, program, small_bound_file], capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
        assert sum(line.startswith("v ") for line in done.stdout.splitlines()) == 50
