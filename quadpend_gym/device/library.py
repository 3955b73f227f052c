"""The generated control step as a library: by the system's C compiler for a CPU, by NVRTC for a GPU.

NVRTC and the driver are those that PyTorch brings; there is no other dependency. A launch does not wait for the GPU.
"""

import ctypes
import site
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from quadpend_gym.core.c_library import FAST, load_c

_OPTIONS = ("--fmad=true", "--ftz=true", "--prec-div=false", "--prec-sqrt=false")  # of NVRTC
_THREADS = 128  # of a block of a GPU


class Library:
    """Functions for n rows, of tensors of shape (field, row).

    Args:
        source: What `control_step` generates.
        device: ``"c"`` or a CUDA device of PyTorch.
        dtype: float32 or float64, the type of the numbers.
        motion: Whether the functions are those of `Motion`, else those of the environment.
    """

    def __init__(self, source: str, device: str, dtype: torch.dtype, motion: bool = False) -> None:
        defines = f"#define THREADS {_THREADS}\n" + "#define SINGLE\n" * (dtype is torch.float32)
        defines += "#define MOTION\n" * motion
        self._context: Any = None
        self._find: Callable[[str], Any]
        if device == "c":
            library = load_c(defines + source, FAST if dtype is torch.float32 else ())
            self._find = lambda name: getattr(library, name)
            self._launch: Any = lambda function, rows, values: function(rows, *values)
        else:
            cubin = compile_cuda(defines + source, _architecture(device))
            self._context, self._module = _load_cubin(cubin)
            self._find, self._launch = self._cuda_function, _launch
        self._functions: dict[str, Any] = {}

    def __call__(self, name: str, rows: int, *arguments: Any) -> None:
        """Run a function for all rows; numbers are given as values of ctypes."""
        if self._context is not None:  # the derivatives run in a thread of PyTorch's
            _check(_driver().cuCtxSetCurrent(self._context))
        if name not in self._functions:
            self._functions[name] = self._find(name)
        values = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, torch.Tensor) else a for a in arguments]
        self._launch(self._functions[name], ctypes.c_longlong(rows), values)

    def _cuda_function(self, name: str) -> Any:
        function = ctypes.c_void_p()
        _check(_driver().cuModuleGetFunction(ctypes.byref(function), self._module, name.encode()))
        return function


def _architecture(device: str) -> str:
    if not torch.cuda.is_available():
        raise ValueError(
            f"device={device!r} needs a GPU, and PyTorch finds none: device='c' computes the same on a CPU"
        )
    return "sm_{}{}".format(*torch.cuda.get_device_capability(device))


@lru_cache(maxsize=1)
def _driver() -> Any:
    return ctypes.CDLL("libcuda.so.1")


@lru_cache(maxsize=1)
def _nvrtc() -> Any:
    """Return NVRTC: the loader's, or that of a wheel."""
    major = (torch.version.cuda or "13").partition(".")[0]
    name = f"libnvrtc.so.{major}"
    folders = {Path(torch.__file__).parents[1], *map(Path, site.getsitepackages())}
    files = [str(file) for folder in folders for file in folder.glob(f"nvidia/*/lib/{name}")]
    try:
        return ctypes.CDLL(files[0] if files else name)
    except OSError as error:
        raise ValueError(f"device='cuda' needs {name}, which the CUDA builds of PyTorch bring: {error}") from error


def compile_cuda(source: str, architecture: str, nvrtc: Any = None) -> bytes:
    """Return machine code for an architecture such as ``"sm_90"``; it needs no GPU.

    Raises:
        RuntimeError: The compiler refuses the source.
    """
    library, program = nvrtc or _nvrtc(), ctypes.c_void_p()
    library.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"control_step.cu", 0, None, None)
    every = f"--gpu-architecture={architecture}", "--std=c++17", "--device-as-default-execution-space", *_OPTIONS
    given = (ctypes.c_char_p * len(every))(*(option.encode() for option in every))
    failed = library.nvrtcCompileProgram(program, len(every), given)

    def read(what: str) -> bytes:
        size = ctypes.c_size_t()
        getattr(library, f"nvrtcGet{what}Size")(program, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        getattr(library, f"nvrtcGet{what}")(program, buffer)
        return buffer.raw

    result = read("ProgramLog") if failed else read("CUBIN")
    library.nvrtcDestroyProgram(ctypes.byref(program))
    if failed:
        raise RuntimeError(f"NVRTC does not compile the control step: {result.decode()}")
    return result


def _load_cubin(cubin: bytes) -> Any:
    torch.zeros(1, device="cuda")  # makes the context
    context, module = ctypes.c_void_p(), ctypes.c_void_p()
    _check(_driver().cuCtxGetCurrent(ctypes.byref(context)))
    _check(_driver().cuModuleLoadData(ctypes.byref(module), cubin))
    return context, module


def _launch(function: Any, rows: ctypes.c_longlong, values: list[Any]) -> None:
    arguments = [rows, *values]
    pointers = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(item) for item in arguments))
    blocks = -(-rows.value // _THREADS)
    stream = ctypes.c_void_p(torch.cuda.current_stream().cuda_stream)
    _check(_driver().cuLaunchKernel(function, blocks, 1, 1, _THREADS, 1, 1, 0, stream, pointers, None))


def _check(code: int) -> None:
    if code:
        raise RuntimeError(f"CUDA error {code}")
