"""Compile kernel text as OpenMM's CUDA platform would, on a machine without a GPU.

By NVRTC and ptxas of the extra "cuda-check", behind the definitions that OpenMM puts in front of every kernel, which
are text in its library for CUDA.
"""

import ctypes
import re
import subprocess
import sys
from pathlib import Path

import pytest

_TYPES = {"single": ("float", "float"), "mixed": ("float", "double"), "double": ("double", "double")}
_USES = {"single": "", "mixed": "#define USE_MIXED_PRECISION 1\n", "double": "#define USE_DOUBLE_PRECISION 1\n"}


def installed(pattern):
    """Return a file of a package; skip the test if it is not installed."""
    for folder in map(Path, sys.path):
        if found := sorted(folder.glob(pattern)):
            return found[0]
    return pytest.skip(f'{pattern} is not installed: python -m pip install "openmm-exactrb[cuda-check]"')


def openmm_definitions():
    """Return the text of common.cu and of vectorOps.cu, by a line of either."""
    data = installed("OpenMM.libs/lib/plugins/libOpenMMCUDA.so").read_bytes()
    texts = []
    for line in (b'#define KERNEL extern "C" __global__', b"This file defines vector operations to simplify"):
        at = data.index(line)
        texts.append(data[data.rindex(b"\0", 0, at) + 1 : data.index(b"\0", at)].decode())
    return "".join(texts)


def as_compiled(text, precision):
    """Return text behind what OpenMM puts in front of it in a precision."""
    lines = [f"typedef {kind} {name};\n" for kind, name in zip(_TYPES[precision], ("real", "mixed"), strict=True)]
    for n in (2, 3, 4):
        for kind, name in zip(_TYPES[precision], ("real", "mixed"), strict=True):
            lines.append(f"typedef {kind}{n} {name}{n};\n#define make_{name}{n} make_{kind}{n}\n")
    return "".join([*lines, _USES[precision], openmm_definitions(), "#define PADDED_NUM_ATOMS 23584\n", text])


def ptx(source, arch):
    """Return the code for a virtual architecture; AssertionError with the compiler's log if it fails."""
    nvrtc = ctypes.CDLL(str(installed("nvidia/cuda_nvrtc/lib/libnvrtc.so.12")))
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"kernels.cu", 0, None, None)
    options = (ctypes.c_char_p * 2)(f"--gpu-architecture=compute_{arch}".encode(), b"--use_fast_math")
    failed = nvrtc.nvrtcCompileProgram(program, 2, options)
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    assert not failed, log.value.decode()
    nvrtc.nvrtcGetPTXSize(program, ctypes.byref(size))
    code = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetPTX(program, code)
    return code.value


def needs(source, arch, folder):
    """Return the registers of each kernel, and the bytes that it spills."""
    assembler = installed("nvidia/cuda_nvcc/bin/ptxas")
    assembler.chmod(0o755)
    file = folder / f"{arch}.ptx"
    file.write_bytes(ptx(source, arch))
    done = subprocess.run(
        [assembler, "-v", f"-arch=sm_{arch}", file, "-o", folder / "out"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    pattern = r"entry function '(\w+)'.*?(\d+) bytes spill stores, (\d+) bytes spill loads.*?Used (\d+) registers"
    found = re.findall(pattern, done.stdout + done.stderr, re.DOTALL)
    return {name: (int(registers), int(stores) + int(loads)) for name, stores, loads, registers in found}
