"""The native code without Python: builds, test programs on it, and its C interface by ctypes."""

from __future__ import annotations

import ctypes
import subprocess
import zlib
from pathlib import Path

import numpy as np

from physkin_core.native_module import native
from physkin_core.runtime.bound_file import save_bound_outfit

NATIVE = Path(__file__).parents[1] / "native"
OK, BAD_ARGUMENT, BAD_FILE, BAD_POSE = range(4)
INSTALLED = Path(native.__file__).parent
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O1", "-g1")


def build_library(folder, compiler="c++", *flags, options=()):
    """Builds the native code without its Python binding; returns the folder with its libraries."""
    build_type = "Debug" if "-O1" in flags else "Release"
    configure = ["cmake", "-S", NATIVE, "-B", folder, "-DPHYSKIN_PYTHON_MODULE=OFF", f"-DCMAKE_CXX_COMPILER={compiler}"]
    configure += [f"-DCMAKE_BUILD_TYPE={build_type}", f"-DCMAKE_CXX_FLAGS={' '.join(('-Werror', *flags))}", *options]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=subprocess.DEVNULL)
    return folder


def build_program(library, source, compiler="c++", *flags):
    """Builds a C++ test program on a library built with the same compiler and flags; returns it."""
    program = library / Path(source).stem
    command = [compiler, "-std=c++17", "-O1", *flags, "-I", NATIVE / "src", "-I", NATIVE / "include", source]
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


def save_one(garment, path, *, name="g", joint_names=None, fabrics=("as bound",)):
    """A bound garment file of one garment; its joints are `joint 0` and so on unless named."""
    joint_names = joint_names or [f"joint {k}" for k in range(len(garment.dof_bone))]
    save_bound_outfit([garment], path, names=[name], joint_names=joint_names, fabrics=[fabrics])


def resealed(data: bytes) -> bytes:
    """A bound garment file with a checksum that fits, as someone would give it who knows the format."""
    return data[:12] + zlib.crc32(data[16:]).to_bytes(4, "little") + data[16:]


class Options(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_uint32),
        ("precision", ctypes.c_char_p),
        ("instruction_set", ctypes.c_char_p),
    ]


def options(precision=None, instruction_set=None):
    return Options(ctypes.sizeof(Options), precision, instruction_set)


def c_library():
    """The installed C library."""
    loaded = ctypes.CDLL(str(INSTALLED / "libphyskin_c.so"))
    for name in ("physkin_last_error", "physkin_joint_name", "physkin_precision", "physkin_instruction_set"):
        getattr(loaded, name).restype = ctypes.c_char_p
    loaded.physkin_part_name.restype = loaded.physkin_fabric_name.restype = ctypes.c_char_p
    loaded.physkin_fabric_name.argtypes = [ctypes.c_void_p, ctypes.c_int32, ctypes.c_int32]
    loaded.physkin_set_fabric.argtypes = [ctypes.c_void_p, ctypes.c_int32, ctypes.c_char_p]
    loaded.physkin_part_name.argtypes = [ctypes.c_void_p, ctypes.c_int32]
    loaded.physkin_part_range.argtypes = [ctypes.c_void_p, ctypes.c_int32, *[ctypes.c_void_p] * 4]
    loaded.physkin_faces.restype = ctypes.POINTER(ctypes.c_int32)
    loaded.physkin_faces.argtypes = loaded.physkin_close.argtypes = [ctypes.c_void_p]
    for name in ("vertex_count", "joint_count", "face_count", "precision", "instruction_set"):
        getattr(loaded, f"physkin_{name}").argtypes = [ctypes.c_void_p]
    loaded.physkin_joint_name.argtypes = [ctypes.c_void_p, ctypes.c_int32]
    for name in ("physkin_step", "physkin_step_accelerated"):
        getattr(loaded, name).argtypes = [*[ctypes.c_void_p] * 4, ctypes.c_int32, ctypes.c_ssize_t]
    loaded.physkin_step_moving.argtypes = [*[ctypes.c_void_p] * 2, ctypes.c_double, *loaded.physkin_step.argtypes[2:]]
    loaded.physkin_set_sway.argtypes = [ctypes.c_void_p, ctypes.c_double]
    loaded.physkin_reset.argtypes = [ctypes.c_void_p]
    loaded.physkin_set_wind.argtypes = [ctypes.c_void_p] * 2
    loaded.physkin_open_memory.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_void_p]
    return loaded


def load(c, data, how=None):
    """Status and garment."""
    garment = ctypes.c_void_p()
    pointer = None if how is None else ctypes.byref(how)
    return c.physkin_open_memory(data, len(data), pointer, ctypes.byref(garment)), garment


def step(c, garment, pose, gravity, out, columns=6, stride=6):
    return c.physkin_step(garment, pose.ctypes.data, gravity.ctypes.data, out.ctypes.data, columns, stride)


def step_moving(c, garment, pose, time, root, out):
    root = np.array(root, dtype=np.float64)
    return c.physkin_step_moving(garment, pose.ctypes.data, time, root.ctypes.data, out.ctypes.data, 6, 6)
