"""Several processes that train one model: `torchrun --nproc-per-node=N -m physkin_training ...`.

Each process draws its own share of a step's samples, and gradients are averaged: one all-reduce of all gradients in one
flat tensor rather than torch's DistributedDataParallel. A step calls parts of the drape by themselves, drops its
gradients and is recorded as a CUDA graph; DistributedDataParallel wants one `forward`, gradients kept in its buckets
and eleven steps before a recording. The model is so small (some MB) that overlapping transfer and backward pass would
gain next to nothing.

Tensors on GPUs travel by NCCL, those on the CPU by gloo.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.distributed as dist

from physkin_training.devices import resolve_device

__all__ = ["Processes", "join", "leave"]

LETTING_GO = 0.2
"""Time [s] that gloo's threads get to let go of what they were given."""


@dataclass(frozen=True)
class Processes:
    """This process's `rank` among `count` processes. Alone, nothing is sent anywhere.

    Every process must call `average`, `broadcast`, `gather` and `any` in the same order.
    """

    rank: int = 0
    count: int = 1

    @property
    def writes(self) -> bool:
        """Whether this process is the one that writes files and messages."""
        return self.rank == 0

    def average(self, tensors: Sequence[torch.Tensor]) -> None:
        """Replace each tensor (float32, one device) by its mean over the processes, which is the same bits on all."""
        if self.count == 1:
            return
        flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
        dist.all_reduce(flat)
        flat /= self.count
        parts = flat.split([tensor.numel() for tensor in tensors])
        torch._foreach_copy_(list(tensors), [part.view_as(tensor) for part, tensor in zip(parts, tensors)])

    def broadcast(self, tensors: Sequence[torch.Tensor]) -> None:
        """Replace each tensor by that of the first process."""
        for tensor in tensors if self.count > 1 else ():
            whole = tensor.contiguous()  # NCCL takes no other
            dist.broadcast(whole, src=0)
            tensor.copy_(whole)

    def gather(self, tensor: torch.Tensor) -> torch.Tensor:
        """All processes' tensors of equal shape, (count, ...)."""
        if self.count == 1:
            return tensor[None]
        parts = [torch.empty_like(tensor) for _ in range(self.count)]
        dist.all_gather(parts, tensor.contiguous())
        return torch.stack(parts)

    def any(self, *flags: bool) -> list[bool]:
        """Each flag, true where it is on any process: clocks and signals differ, what is done about them must not."""
        if self.count == 1:
            return list(flags)
        raised = torch.tensor(flags, dtype=torch.int32)
        dist.all_reduce(raised, op=dist.ReduceOp.MAX)
        return [bool(flag) for flag in raised.tolist()]

    def seed_samples(self, seed: int, step: int) -> None:
        """Seed what is drawn from `step` on, differently on each process."""
        state = np.random.SeedSequence([seed, step, self.rank]).generate_state(2, np.uint32)
        torch.manual_seed(int(state[0]) << 32 | int(state[1]))


def join(device_name: str) -> tuple[Processes, torch.device]:
    """The processes that torchrun started, and this one's device: of several GPUs the one of its local rank.

    Without torchrun this process is alone. Raises ValueError for a device that is not there, one GPU for several
    processes, or fewer GPUs than processes.
    """
    if not dist.is_torchelastic_launched():
        return Processes(), resolve_device(device_name)
    count, here, local = (int(os.environ[name]) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE", "LOCAL_RANK"))
    device = resolve_device(device_name)
    if device.type == "cuda":
        if here > 1 and device_name != "cuda":
            raise ValueError(
                f"device {device_name!r} is one GPU for {here} processes; use cuda, which gives each its own"
            )
        if here > torch.cuda.device_count():
            raise ValueError(f"{here} processes need as many GPUs, there are {torch.cuda.device_count()}")
        if device_name == "cuda":
            device = torch.device("cuda", local)
        torch.cuda.set_device(device)
    dist.init_process_group("gloo" if device.type == "cpu" else "cpu:gloo,cuda:nccl")
    return Processes(dist.get_rank(), count), device


def leave() -> None:
    """Take leave of the other processes. CUDA graphs that hold an all-reduce must be gone by then."""
    if dist.is_initialized():
        dist.barrier()
        # gloo's threads let go of the last tensors a moment after the main thread has them, for which they need the
        # interpreter; where it is already ending, they abort the process (torch 2.13, Python 3.11).
        time.sleep(LETTING_GO)
        dist.destroy_process_group()
