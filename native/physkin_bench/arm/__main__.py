"""Modelled cycles of a frame, a Markdown table: `PYTHONPATH=native python -m physkin_bench.arm tshirt.physkin`.

Needs g++-aarch64-linux-gnu, qemu-user with plugins, and llvm-mca 16 or newer. Every block of instructions that runs
in a frame is given to llvm-mca as the body of a loop; its cycles a turn, times how often it ran, are summed. Caches,
branch prediction and what overlaps from block to block are left out.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent
NATIVE = HERE.parents[1]
LEVELS = ("baseline", "dotprod", "i8mm")
FEW, MANY = 10, 60
"""Frames of two runs; their difference is without what opening the file takes."""
TARGETS = ("b", "bl", "cbz", "cbnz", "tbz", "tbnz", "adr", "adrp")
DRIVER = ("main", "__sinf", "physkin_joint_range")
TURNS = 100


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m physkin_bench.arm", description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="what `physkin bind` wrote")
    parser.add_argument("--cpus", default="neoverse-n1,neoverse-n2,neoverse-v1", help="of llvm-mca, joined by commas")
    parser.add_argument("--llvm-mca", default="llvm-mca-19", help="the program")
    given = parser.parse_args()
    print("| | processor | instructions | cycles | networks | skinning | normals |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        program, plugin = built(Path(folder))
        listing = instructions_of(program)
        for level in LEVELS:
            counts = frame_blocks(program, plugin, given.file.resolve(), level)
            blocks = {at: count for at, count in counts.items() if listing[at[0]][0] not in DRIVER}
            executed = sum(size * count for (_, size), count in blocks.items())
            for cpu in given.cpus.split(","):
                cycles = block_cycles(given.llvm_mca, cpu, listing, list(blocks))
                parts = Counter()
                for at, count in blocks.items():
                    parts[part_of(listing[at[0]][0])] += cycles[at] * count
                shares = " | ".join(f"{parts[part]:,.0f}" for part in ("networks", "skinning", "normals"))
                print(f"| `{level}` | {cpu} | {executed:,.0f} | {sum(parts.values()):,.0f} | {shares} |")


def built(folder: Path) -> tuple[Path, Path]:
    """A program for ARM that drapes, linked statically, and qemu's plugin."""
    arm = ["-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=aarch64", "-DPHYSKIN_PYTHON_MODULE=OFF"]
    arm += ["-DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++"]
    subprocess.run(["cmake", "-S", NATIVE, "-B", folder, *arm], check=True, stdout=subprocess.DEVNULL)
    build = ["cmake", "--build", folder, "--target", "physkin_evaluator", "--parallel", "2"]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    include, program, plugin = ("-I", NATIVE / "src", "-I", NATIVE / "include"), folder / "frames", folder / "counts.so"
    driver = [*("aarch64-linux-gnu-gcc", "-O2", *include, "-c", HERE / "frames.c"), "-o", folder / "frames.o"]
    subprocess.run(driver, check=True)
    host = [*NATIVE.glob("src/c_*.cpp"), *NATIVE.glob("src/file_format/*.cpp")]
    link = [*host, folder / "frames.o", folder / "libphyskin_evaluator.a", "-o", program]
    subprocess.run(["aarch64-linux-gnu-g++", "-std=c++17", "-O3", "-static", *include, *link], check=True)
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", HERE / "block_counts.c", "-o", plugin], check=True)
    return program, plugin


def frame_blocks(program: Path, plugin: Path, file: Path, level: str) -> dict[tuple[int, int], float]:
    """How often each block, by its address and length in instructions, runs in a frame."""
    few, many = (run_blocks(program, plugin, file, level, frames) for frames in (FEW, MANY))
    blocks = {at: (many[at] - few[at]) / (MANY - FEW) for at in many if many[at] > few[at]}
    for at in sorted(blocks):  # qemu cuts blocks at the end of a page
        while (after := following(blocks, at)) is not None:
            count = blocks.pop(at)
            del blocks[after]
            at = (at[0], at[1] + after[1])
            blocks[at] = count
    return blocks


def following(blocks: dict[tuple[int, int], float], at: tuple[int, int]) -> tuple[int, int] | None:
    """The block that begins where this one ends and runs as often."""
    if at not in blocks:
        return None
    end = at[0] + 4 * at[1]
    found = [other for other in blocks if other[0] == end and blocks[other] == blocks[at]]
    return found[0] if len(found) == 1 else None


def run_blocks(program: Path, plugin: Path, file: Path, level: str, frames: int) -> Counter:
    out = plugin.with_suffix(".txt")
    command = ["qemu-aarch64", "-cpu", "max,sve=off", "-plugin", f"{plugin},out={out}"]
    subprocess.run([*command, program, file, str(frames), level], check=True)
    counts: Counter = Counter()
    for line in out.read_text().splitlines():
        address, size, count = map(int, line.split())
        counts[address, size] += count
    return counts


def instructions_of(program: Path) -> dict[int, tuple[str, str]]:
    """The function that each address is in, and its instruction as llvm-mca reads it."""
    command = ["aarch64-linux-gnu-objdump", "-dC", "--no-show-raw-insn", program]
    listing, function = {}, ""
    for line in subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines():
        if found := re.match(r"[0-9a-f]+ <(.*)>:$", line):
            function = found[1]
        elif found := re.match(r"\s+([0-9a-f]+):\t([^\t]+)\t?(.*)$", line):
            operands = re.sub(r"\s*(//|<).*", "", found[3])
            if found[2] in TARGETS or found[2].startswith("b."):
                operands = re.sub(r"[0-9a-f]{4,}$", ".", operands)
            listing[int(found[1], 16)] = (function, f"{found[2]} {operands}")
    return listing


def block_cycles(mca: str, cpu: str, listing: dict[int, tuple[str, str]], blocks: list[tuple[int, int]]) -> dict:
    """Cycles of each block, by llvm-mca."""
    text = []
    for number, (address, size) in enumerate(blocks):
        body = [listing[address + 4 * k][1] for k in range(size)]
        text += [f"# LLVM-MCA-BEGIN {number}", *body, "# LLVM-MCA-END"]
    command = [mca, "-march=aarch64", f"-mcpu={cpu}", "-mattr=+dotprod,+i8mm", f"-iterations={TURNS}"]
    command += ["-instruction-info=0", "-resource-pressure=0"]
    done = subprocess.run(command, input="\n".join(text) + "\n", capture_output=True, text=True, check=True)
    return {at: int(total) / TURNS for at, total in zip(blocks, re.findall(r"Total Cycles:\s+(\d+)", done.stdout))}


def part_of(function: str) -> str:
    names = {"dense": "networks", "skin_blocks": "skinning", "ring_normals": "normals"}
    return next((part for name, part in names.items() if name in function), "rest")


if __name__ == "__main__":
    main()
