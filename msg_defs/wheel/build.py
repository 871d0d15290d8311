#!/usr/bin/env python3
"""Build physkin_msgs against the ROS 2 wheels and pack it as a wheel, for environments without a ROS installation.

    python msg_defs/wheel/build.py --install

builds for the Python it runs under, keeps the result in `build/physkin_msgs` and installs it into that Python's
environment; and with it tf2_msgs, of which there is no wheel elsewhere, unless that Python has it. A wheel that is
already there for the same messages is not built again. Where ROS 2 is installed, build `msg_defs` with colcon instead.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path
from xml.etree import ElementTree

WHEEL_FILES = Path(__file__).resolve().parent
PACKAGE = WHEEL_FILES.parent
TF_PACKAGE = PACKAGE / "tf2_msgs"
DEFAULT_WORK = PACKAGE.parent / "build" / "physkin_msgs"
REQUIREMENTS = ("ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces")


class BuildError(RuntimeError):
    """A step of the build failed."""


def main(argv: list[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, default=DEFAULT_WORK, help="where to build and keep the wheel")
    parser.add_argument("--install", action="store_true", help="install the wheel into this Python's environment")
    arguments = parser.parse_args(argv)
    try:
        packages = [PACKAGE] if _has_tf_messages_of_others() else [PACKAGE, TF_PACKAGE]
        wheels = [str(build_wheel(arguments.work.resolve(), package)) for package in packages]
        if arguments.install:
            _run([sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", *wheels])
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print("\n".join(wheels))
    return 0


def build_wheel(work: Path, package: Path = PACKAGE) -> Path:
    """Path of a package's wheel for its present sources and Python, built if it is not there. Raises BuildError."""
    work.mkdir(parents=True, exist_ok=True)
    (work / "COLCON_IGNORE").touch()  # what is installed in here are packages too, ours a second time
    folder = work / _fingerprint(package)
    wheel = folder / _wheel_name(package)
    if wheel.exists():
        return wheel
    python = _build_environment(work)
    environment = _without_ros(os.environ)
    prefix = python.parent.parent
    environment["PATH"] = f"{python.parent}{os.pathsep}{environment['PATH']}"
    environment["CMAKE_PREFIX_PATH"] = environment["AMENT_PREFIX_PATH"] = str(prefix)
    shutil.rmtree(folder, ignore_errors=True)
    name, _ = _name_and_version(package)
    configure = [
        *("cmake", "-S", str(package), "-B", str(folder / "cmake"), "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release"),
        *(f"-DCMAKE_INSTALL_PREFIX={folder / 'prefix'}", "-DBUILD_TESTING=OFF", "-DPython3_FIND_VIRTUALENV=ONLY"),
        f"-DCMAKE_PROJECT_{name}_INCLUDE={WHEEL_FILES / 'targets_fix.cmake'}",
    ]
    _run(configure, environment)
    _run(["cmake", "--build", str(folder / "cmake"), "--target", "install"], environment)
    _pack(folder / "prefix", wheel, package)
    return wheel


def _build_environment(work: Path) -> Path:
    """Python of a virtual environment that holds the generators, made once for each Python and set of requirements."""
    requirements = WHEEL_FILES / "requirements.txt"
    folder = work / f"environment-{_python_tag()}-{hashlib.sha256(requirements.read_bytes()).hexdigest()[:12]}"
    python = folder / "bin" / "python"
    if not (folder / "complete").exists():
        for outdated in work.glob(f"environment-{_python_tag()}*"):
            shutil.rmtree(outdated)
        venv.create(folder, clear=True, with_pip=True)
        _run([str(python), "-m", "pip", "install", "--quiet", "-r", str(requirements)], _without_ros(os.environ))
        (folder / "complete").touch()
    return python


def _pack(prefix: Path, wheel: Path, package: Path) -> None:
    """Write the wheel as the ROS 2 wheels are laid out: the Python package, and lib, share and include as data."""
    name, version = _name_and_version(package)
    files: dict[str, bytes] = {}
    site = next(prefix.glob("lib/python3*/site-packages"))
    for path in sorted((site / name).rglob("*")):
        if path.is_file() and path.suffix != ".c" and "__pycache__" not in path.parts:
            files[str(path.relative_to(site))] = path.read_bytes()
    for path in sorted(path for part in ("lib", "share", "include") for path in (prefix / part).rglob("*")):
        if path.is_file() and "site-packages" not in path.parts:
            files[f"{name}-{version}.data/data/{path.relative_to(prefix)}"] = path.read_bytes()
    requires = "".join(f"Requires-Dist: {requirement}\n" for requirement in REQUIREMENTS)
    metadata = f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version}\n{requires}"
    tag = f"{_python_tag()}-linux_{os.uname().machine}"
    wheel_info = f"Wheel-Version: 1.0\nGenerator: physkin\nRoot-Is-Purelib: false\nTag: {tag}\n"
    info = f"{name}-{version}.dist-info"
    files |= {f"{info}/METADATA": metadata.encode(), f"{info}/WHEEL": wheel_info.encode()}
    record = "".join(f"{path},sha256={_sha256(data)},{len(data)}\n" for path, data in files.items())
    files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    partial = wheel.with_suffix(".partial")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in files.items():
            entry = zipfile.ZipInfo(path, (2020, 1, 1, 0, 0, 0))
            entry.external_attr = (0o100755 if path.endswith(".so") else 0o100644) << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)
    partial.replace(wheel)


def _has_tf_messages_of_others() -> bool:
    """Whether this Python has tf2_msgs from elsewhere than a wheel of ours."""
    if importlib.util.find_spec(TF_PACKAGE.name) is None:
        return False
    try:
        return "Generator: physkin" not in (importlib.metadata.distribution(TF_PACKAGE.name).read_text("WHEEL") or "")
    except importlib.metadata.PackageNotFoundError:
        return True


def _name_and_version(package: Path) -> tuple[str, str]:
    root = ElementTree.parse(package / "package.xml").getroot()
    return root.findtext("name", ""), root.findtext("version", "")


def _python_tag() -> str:
    return "-".join([f"cp{sys.version_info.major}{sys.version_info.minor}"] * 2)


def _wheel_name(package: Path = PACKAGE) -> str:
    return f"{'-'.join(_name_and_version(package))}-{_python_tag()}-linux_{os.uname().machine}.whl"


def _fingerprint(package: Path = PACKAGE) -> str:
    """Changes with every source of the wheel."""
    digest = hashlib.sha256()
    for path in sorted(
        [*package.glob("*.*"), *package.glob("msg/*"), *package.glob("srv/*"), *WHEEL_FILES.glob("*.*")]
    ):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _sha256(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def _without_ros(environment) -> dict[str, str]:
    """The environment without what points at another Python's ROS libraries."""
    dropped = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "VIRTUAL_ENV", "_ROS_WHEELS")
    return {key: value for key, value in environment.items() if not key.startswith(dropped)}


def _run(command: list[str], environment: dict[str, str] | None = None) -> None:
    result = subprocess.run(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if result.returncode:
        lines = "\n".join(result.stdout.splitlines()[-30:])
        raise BuildError(f"{' '.join(command[:4])} ... exited with {result.returncode}:\n{lines}")


if __name__ == "__main__":
    sys.exit(main())
