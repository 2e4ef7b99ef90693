"""Whether the device that a run names is there."""

from __future__ import annotations

from pneuma.config import CPU, Run
from pneuma.errors import UserError


def check_device(run: Run) -> None:
    """Refuse a run whose device is not there; Stable-Baselines3 would take the CPU without a word."""
    if run.device == CPU:
        return
    import torch

    if not torch.cuda.is_available():
        raise UserError(
            f'device = "{run.device}" is not allowed: PyTorch {torch.__version__} finds no CUDA device here. '
            "Install its CUDA build, or leave device out"
        )
