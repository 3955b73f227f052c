"""Signals that wait for what must not be interrupted."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm.auto import tqdm


@contextmanager
def signals_wait() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the end of the block."""
    received: list[int] = []
    handlers: dict[int, Any] = {}
    # Signals interrupt no other thread; a handler that C has set is None for Python, which could not set it again.
    is_main = threading.current_thread() is threading.main_thread()
    numbers = [number for number in (signal.SIGINT, signal.SIGTERM) if is_main and signal.getsignal(number) is not None]
    try:
        for number in numbers:
            handlers[number] = signal.signal(number, lambda number, _: received.append(number))
        yield
    finally:
        for changed, handler in handlers.items():
            signal.signal(changed, handler)
        for waited in received:
            signal.raise_signal(waited)


def progress_bar(**options: Any) -> Any:
    """Return a `tqdm`, which no interruption leaves half made: that would print a traceback when deleted."""
    with signals_wait():
        return tqdm(**options)
