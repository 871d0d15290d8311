"""What `physkin doctor` looks at where training is installed: torch and Warp, and whether they see a GPU."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from physkin_core.doctor.doctor import Finding
from physkin_training.quiet_warp import wp

__all__ = ["look"]

CPU_ONLY = "training on a CPU takes hours; for an NVIDIA GPU: its driver, and torch built for CUDA (pytorch.org)"


def look() -> Iterator[Finding]:
    """One finding after the other."""
    if torch.cuda.is_available():
        names = ", ".join(torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count()))
        yield Finding("torch", "good", f"{torch.__version__} on {names}")
    else:
        yield Finding("torch", "note", f"{torch.__version__} sees no GPU", CPU_ONLY)
    wp.init()
    devices = [device.name for device in wp.get_cuda_devices()]
    if devices:
        yield Finding("warp", "good", f"{wp.config.version} on {', '.join(devices)}")
    elif torch.cuda.is_available():
        yield Finding(
            "warp", "broken", f"{wp.config.version} sees no GPU, torch does", "update warp-lang, or the driver"
        )
    else:
        yield Finding("warp", "note", f"{wp.config.version} sees no GPU", CPU_ONLY)
