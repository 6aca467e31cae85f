"""The multiply-adds of the convolutions on 64-bit Arm, read from the machine code: nothing else may stand in their way.

python tests/kernels/arm_blocks.py OBJECT [--objdump OBJDUMP] [--mca LLVM-MCA]

A block is a run of instructions without a branch. Those with many multiply-adds, where a frame's arithmetic is, must
keep their sums in registers: none may store a vector to the stack or load one from there. With --mca (of LLVM 16 or
newer), prints how much of the time of the two multiply-add ports they use, by LLVM's model of the Neoverse N1. LLVM has
none of the Cortex-A76, which is the same core, nor of its successor A78, which has the same two ports.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from collections.abc import Iterator

MANY = 24
FEWEST = 20  # such blocks of a build
PORTS = 2
FUNCTION = re.compile(r"multiply<float, \d, [48], \d>|block<float, [48], \d, \d, \w+>")


def blocks(listing: str) -> Iterator[tuple[str, list[str]]]:
    """Function and instructions of every block in objdump's listing."""
    targets = set(re.findall(r"\t(?:b|b\.\w+|cbn?z|tbn?z)\t(?:.*, )?([0-9a-f]+) <", listing))
    name, block = "", list[str]()
    for line in listing.splitlines():
        if start := re.match(r"[0-9a-f]+ <(.*)>:$", line):
            name, block = start[1], []
        elif instruction := re.match(r" *([0-9a-f]+):\t(.*)$", line):
            if instruction[1] in targets and block:
                yield name, block
                block = []
            block.append(instruction[2].split("//")[0].strip())
            if re.match(r"(b|b\.\w+|cbn?z|tbn?z|ret|br)\b", block[-1]):
                yield name, block[:-1]
                block = []


def uses_stack(instruction: str) -> bool:
    return re.match(r"(ldr|ldp|str|stp|ldur|stur)\tq.*\[sp", instruction) is not None


def cycles(mca: str, block: list[str]) -> float:
    """Of one run of the block among many."""
    command = [mca, "-mtriple=aarch64", "-mcpu=neoverse-n1", "-iterations=200"]
    report = subprocess.run(command, input="\n".join(block), capture_output=True, text=True, check=True).stdout
    return int(re.findall(r"Total Cycles: +(\d+)", report)[0]) / 200


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("object")
    parser.add_argument("--objdump", default="aarch64-linux-gnu-objdump")
    parser.add_argument("--mca")
    arguments = parser.parse_args()
    command = [arguments.objdump, "-d", "--demangle", "--no-show-raw-insn", arguments.object]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found, spilling = 0, []
    for name, block in blocks(listing):
        products = sum(instruction.startswith("fmla") for instruction in block)
        function = FUNCTION.search(name)
        if products < MANY or function is None:
            continue
        found += 1
        spills = sum(map(uses_stack, block))
        if spills:
            spilling.append(f"{function[0]}: {spills} of {len(block)} instructions")
        line = f"{function[0]:24s} {products} of {len(block)} instructions"
        if arguments.mca:
            line += f", {100 * products / PORTS / cycles(arguments.mca, block):.0f} % of the ports' time"
        print(line, f" {spills} spills" if spills else "")
    if found < FEWEST or spilling:
        raise SystemExit(f"expected at least {FEWEST} blocks, none with spills, got {found} and {spilling}")


if __name__ == "__main__":
    main()
