"""What the compiler made of the CUDA kernels: resources of every kernel on every architecture, and wide accesses.

Reads the library that was built (`ANYNET_CUDA=ON python setup.py build_ext --inplace`; warnings are errors there) with
NVIDIA's cuobjdump and nvdisasm, from the toolkit or from PyPI (nvidia-cuda-cuobjdump, nvidia-cuda-nvdisasm).
"""

from __future__ import annotations

import os
import re
import shutil
import site
import subprocess
from collections import Counter, defaultdict
from pathlib import Path

import pytest

import anynet_ext

pytestmark = pytest.mark.slow

LIBRARY = Path(anynet_ext.__file__).parent / "_C_cuda.so"
ARCHITECTURES = {"sm_75", "sm_80", "sm_86", "sm_87", "sm_89", "sm_90", "sm_100", "sm_120"}

# Registers a thread may use, so that a multiprocessor (65,536 registers) holds at least the blocks named.
REGISTERS = {
    "batch_norm::combine_gradients": 64,  # 256 threads: four
    "batch_norm::combine_statistics": 64,
    "batch_norm::gather_gradients": 64,
    "batch_norm::gather_statistics": 64,
    "batch_norm::normalize": 64,
    "batch_norm::spread_gradients": 64,
    "candidates::costs": 96,  # 128 threads: five
    "candidates::expect": 64,
    "conv::forward": 128,  # 128 threads: four
    "conv::pair": 128,
    "convex_upsampling::upsample": 64,
    "cost_volume::forward_grid": 128,  # 512 threads: one block, the usual ones of 128 threads: four
    "cost_volume::forward_disparity": 80,  # 128 threads: six blocks
    "cost_volume::backward_grid": 128,  # 128 threads: four
    "cost_volume::backward_disparity": 128,  # 128 threads: four
    "max_pool::pool": 64,
    "occlusion::fill": 64,
    "read_image::read_pixels": 64,
    "refinement_guide::guide": 64,
    "soft_argmin::forward": 128,  # 128 threads: four
    "soft_argmin::backward": 128,
    "spatial_propagation::forward": 128,  # up to 512 threads: one
    "spatial_propagation::forward_many": 128,
    "spatial_propagation::backward": 168,  # up to 384 threads: one
    "spatial_propagation::backward_many": 128,
    "stem::both_layers": 128,  # 64 threads: eight
    "upsample::add": 64,
    "upsample::concat": 64,
    "upsample::sum_maps": 64,
    "warp::forward": 64,  # 128 threads: eight
    "warp::backward": 80,
}

# 16-byte accesses each kernel is written for: loads (LDG) and stores (STG) of global memory, loads of shared (LDS).
# "packs" stands for the variant for aligned rows, <T, 16 / sizeof(T)> or <T, true>, or for several output channels.
WIDE = {
    "conv::forward packs": {"LDS"},
    "conv::pair": {"LDS"},
    "soft_argmin::forward packs": {"LDG", "STG"},
    "soft_argmin::backward packs": {"LDG", "STG"},
    "spatial_propagation::forward packs": {"LDG", "STG"},
    "cost_volume::forward_grid": {"LDS"},
}


def tool(name: str) -> str:
    folders = [str(path) for root in site.getsitepackages() for path in Path(root).glob("nvidia/*/bin")]
    found = shutil.which(name, path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/local/cuda/bin", *folders]))
    if found is None:
        pytest.skip(f"{name} not found")
    return found


@pytest.fixture(scope="module")
def cuobjdump():
    if not LIBRARY.exists():
        pytest.skip(f"{LIBRARY.name} is not built")
    program, disassembler = tool("cuobjdump"), tool("nvdisasm")

    def run(option: str) -> str:
        path = f"{Path(disassembler).parent}{os.pathsep}{os.environ.get('PATH', '')}"
        environment = {**os.environ, "PATH": path}
        command = [program, option, LIBRARY]
        return subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout

    return run


def kernel(mangled: str) -> tuple[str, bool]:
    """Name ("warp::forward"), and whether this is the variant for aligned rows."""
    names = "|".join(sorted({name.split("::")[1] for name in REGISTERS}, key=len, reverse=True))
    match = re.search(rf"_GLOBAL__N__[0-9a-f]+_\d+_(\w+?)_cuda_cu_\w+?\d({names})I(\w+)", mangled)
    assert match is not None, mangled
    return f"{match[1]}::{match[2]}", re.search(r"L(i[2-9]|b1)E", match[3]) is not None


def per_architecture(listing: str):
    """Yields (architecture, kernel, lines) for each kernel of a listing."""
    architecture = owner = function = ""
    lines: list[str] = []
    for line in listing.splitlines():
        if match := re.match(r"arch = (sm_\d+)", line):
            architecture = match[1]
        elif match := re.search(r"Function ?:? (\w+)", line):
            if function:
                yield owner, function, lines
            owner, function, lines = architecture, match[1], []
        else:
            lines.append(line)
    if function:
        yield owner, function, lines


def test_resources(cuobjdump):
    seen: dict[str, Counter[str]] = defaultdict(Counter)
    for architecture, mangled, lines in per_architecture(cuobjdump("--dump-resource-usage")):
        usage = {key: int(value) for key, value in re.findall(r"(\w+)(?:\[0\])?:(\d+)", " ".join(lines[:1]))}
        name, _ = kernel(mangled)
        seen[architecture][name] += 1
        assert usage["LOCAL"] == 0, f"{name} on {architecture} uses local memory"
        assert usage["STACK"] == 0, f"{name} on {architecture} has a stack of {usage['STACK']} bytes: registers spill"
        assert usage["SHARED"] <= 1024, f"{name} on {architecture}: static shared memory, ours is dynamic"
        assert usage["REG"] <= REGISTERS[name], f"{name} on {architecture} uses {usage['REG']} registers"
    for architecture, names in seen.items():
        assert set(names) == set(REGISTERS), architecture
    if "TORCH_CUDA_ARCH_LIST" not in os.environ:
        assert set(seen) == ARCHITECTURES


def test_wide_accesses(cuobjdump):
    found = set()
    for architecture, mangled, lines in per_architecture(cuobjdump("-sass")):
        name, packs = kernel(mangled)
        key = f"{name} packs" if packs else name
        code = " ".join(lines)
        for access in WIDE.get(key, ()):
            assert re.search(rf"\b{access}(\.\w+)*\.128", code), f"{mangled} on {architecture}: no {access} of 16 bytes"
            found.add(key)
        assert not re.search(r"\b(LDL|STL)\b", code), f"{mangled} on {architecture} uses local memory"
        assert not re.search(r"\b(RED|ATOM|ATOMS|ATOMG)\b", code), f"{mangled} on {architecture} uses atomics"
    assert found == set(WIDE)
