"""What one part of a process can change for all others, put back: random states, torch's default type, the working folder."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def process_state_kept() -> Iterator[None]:
    """Put the state of the process back to what it was, however the block ends.

    Where the block itself imports torch, that is put back to what it starts with.
    """
    states, errors = (random.getstate(), np.random.get_state()), np.geterr()
    folder = os.open(".", os.O_RDONLY)  # which may have no name any more
    torch = sys.modules.get("torch")
    if torch is not None:
        of_torch = torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_num_threads()
        device, generator = torch.get_default_device(), torch.get_rng_state()
        deterministic = torch.get_deterministic_debug_mode()
    try:
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])
        np.seterr(**errors)
        os.fchdir(folder)
        os.close(folder)
        if torch is None and (fresh := sys.modules.get("torch")) is not None:
            fresh.set_default_dtype(fresh.float32)
            fresh.set_grad_enabled(True)
        elif torch is not None:
            torch.set_default_dtype(of_torch[0])
            torch.set_grad_enabled(of_torch[1])
            if torch.get_num_threads() != of_torch[2]:
                torch.set_num_threads(of_torch[2])
            if torch.get_default_device() != device:
                torch.set_default_device(device)
            torch.set_rng_state(generator)
            if torch.get_deterministic_debug_mode() != deterministic:
                torch.set_deterministic_debug_mode(deterministic)
