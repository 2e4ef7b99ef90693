"""UPGD for Stable-Baselines3: gradient descent that protects useful weights and perturbs the others.

Elsayed and Mahmood, "Addressing Loss of Plasticity and Catastrophic Forgetting in Continual Learning",
ICLR 2024: reference [23] of the thesis, whose section 6.1 names it as a remedy for policy collapse. The
compiled engine's is in `batched/optimizers.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch

from pneuma.config import stream_seed


class UPGD(torch.optim.Optimizer):
    """Adaptive UPGD, the form with which its authors train PPO, with Adam's moments.

    For a weight w with gradient g, its moments m and v as Adam's, corrected, and noise ξ ~ N(0, 1):

        u ← β u - (1 - β) g w                    the first-order utility: what the loss would gain without w
        s = sigmoid(u / (1 - βᵗ) / max u)        the greatest utility of all weights scales it
        w ← (1 - α λ) w - 2 α (1 - s) (m / (√v + ε) + σ ξ)

    As in the authors' published PPO, the greatest utility is not corrected, so that at first s is nearly 0
    or 1; the factor 2 makes up for s = 1/2 where u = 0; and weight decay λ shrinks w by itself instead of
    being added to the gradient. Here α is `lr`, β `utility_decay` and σ `noise`. The noise is keyed by
    `stream` and the number of the step, so that it needs no state of its own.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor],
        stream: str,
        lr: float = 3e-4,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-5,
        utility_decay: float = 0.999,
        noise: float = 0.001,
        weight_decay: float = 0.0,
    ) -> None:
        self.stream = stream
        settings = {"lr": lr, "betas": betas, "eps": eps, "weight_decay": weight_decay}
        super().__init__(params, {**settings, "utility_decay": utility_decay, "noise": noise})

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> None:  # type: ignore[override]
        moving = [(p, group) for group in self.param_groups for p in group["params"] if p.grad is not None]
        for parameter, group in moving:
            self._take_in(parameter, group)
        highest = torch.stack([self.state[parameter]["utility"].max() for parameter, _ in moving]).max()
        scale = torch.where(highest == 0, torch.ones_like(highest), highest)
        noises = self.draw(int(self.state[moving[0][0]]["step"]), [parameter for parameter, _ in moving])
        for (parameter, group), noise in zip(moving, noises, strict=True):
            self._move(parameter, group, scale, noise)

    def draw(self, step: int, parameters: list[torch.Tensor]) -> list[torch.Tensor]:
        """Return standard normal noise shaped like each parameter, keyed by the step, from 1."""
        key = stream_seed(self.stream, "upgd-noise", step)
        generator = torch.Generator().manual_seed(key)
        return [torch.randn(p.shape, generator=generator, dtype=p.dtype) for p in parameters]

    def _take_in(self, parameter: torch.Tensor, group: dict[str, Any]) -> None:
        """Update a parameter's moments and utility by its gradient."""
        state, gradient = self.state[parameter], parameter.grad
        assert gradient is not None
        if not state:
            state["step"] = torch.tensor(0)
            for name in ("mean", "square", "utility"):
                state[name] = torch.zeros_like(parameter)
        state["step"] += 1
        (b1, b2), kept = group["betas"], group["utility_decay"]
        state["mean"].mul_(b1).add_(gradient, alpha=1 - b1)
        state["square"].mul_(b2).addcmul_(gradient, gradient, value=1 - b2)
        state["utility"].mul_(kept).addcmul_(gradient, parameter, value=kept - 1)

    def _move(
        self, parameter: torch.Tensor, group: dict[str, Any], scale: torch.Tensor, noise: torch.Tensor
    ) -> None:
        state, (b1, b2) = self.state[parameter], group["betas"]
        step = int(state["step"])
        corrected = state["utility"] / ((1 - group["utility_decay"] ** step) * scale)
        free = 1 - torch.sigmoid(corrected)
        root = (state["square"] / (1 - b2**step)).sqrt() + group["eps"]
        adapted = state["mean"] / (1 - b1**step) / root
        parameter.mul_(1 - group["lr"] * group["weight_decay"])
        parameter.sub_(free * (adapted + group["noise"] * noise), alpha=2 * group["lr"])
