"""Builds of the native code without Python, and of test programs on it."""

from __future__ import annotations

import subprocess
from pathlib import Path

NATIVE = Path(__file__).parents[1] / "native"
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O1", "-g1")


def build_library(folder, compiler="c++", *flags, options=()):
    """Builds the native code without its Python binding; returns the folder with its libraries."""
    build_type = "Debug" if "-O1" in flags else "Release"
    configure = ["cmake", "-S", NATIVE, "-B", folder, "-DPHYSKIN_PYTHON_MODULE=OFF", f"-DCMAKE_CXX_COMPILER={compiler}"]
    configure += [f"-DCMAKE_BUILD_TYPE={build_type}", f"-DCMAKE_CXX_FLAGS={' '.join(('-Werror', *flags))}", *options]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=subprocess.DEVNULL)
    return folder


def build_program(library, source, compiler="c++", *flags, inner=()):
    """Builds a C++ test program on a library built with the same compiler and flags; returns it. inner: sources of the
    C library that it uses behind its interface."""
    program = library / Path(source).stem
    command = [compiler, "-std=c++17", "-O1", *flags, "-I", NATIVE / "src", "-I", NATIVE / "include", source, *inner]
    command += [
        "-o",
        program,
        "-L",
        library,
        "-lphyskin_c",
        f"-Wl,-rpath,{library}",
        library / "libphyskin_evaluator.a",
    ]
    subprocess.run(command, check=True)
    return program
