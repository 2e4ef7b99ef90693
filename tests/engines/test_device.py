"""Runs on a GPU: chosen, refused where there is none, and trained without a look into the GPU's memory."""

from __future__ import annotations

import io
import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from pneuma.config import effective_fields, make_run
from pneuma.engines.environment import check_environment
from pneuma.engines.loop import train_run
from pneuma.errors import UserError
from pneuma.store.store import Store
from pneuma.study.identity import run_id
from pneuma.training import worker
from pneuma.training.executors.base import ExecutorConfig, Job

from .trained import LEARNERS, bits, run_of, train

OPEN: dict[str, Any] = {
    "env": "CartPole-v1", "algorithm": "qr-dqn", "horizon": 64, "steps": 256, "evaluation_episodes": 2,
}  # fmt: skip


def test_a_device_chooses_the_engine_and_is_part_of_the_id() -> None:
    default, cuda = make_run({"engine": "sb3"}), make_run({"device": "cuda"})
    assert cuda == replace(default, device="cuda")
    assert run_id(default) == run_id(make_run({"engine": "sb3", "device": "cpu"})) != run_id(cuda)
    assert "device" in effective_fields(default) - effective_fields(make_run({}))


@pytest.fixture
def no_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.mark.usefixtures("no_cuda")
@pytest.mark.parametrize("fields", [{"device": "cuda"}, {**OPEN, "device": "cuda"}], ids=["ppo", "qr-dqn"])
def test_a_device_that_is_not_there_is_refused_before_training(fields: dict[str, Any]) -> None:
    """Stable-Baselines3 would train on the CPU."""
    run = make_run(fields)
    for begin in (check_environment, lambda run: train_run(run, lambda progress: True)):
        with pytest.raises(
            UserError, match='^device = "cuda" is not allowed: PyTorch .* no CUDA device here'
        ):
            begin(run)


def test_a_run_says_on_which_gpu_it_was_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of(device="cuda")
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "NVIDIA H200")
    monkeypatch.setattr(worker, "train_run", lambda run, *rest: train_run(replace(run, device="cpu"), *rest))
    store = Store(tmp_path)
    job = Job({run_id(run): run}, store, ExecutorConfig())
    assert worker.Worker(io.StringIO(), threading.Event()).train(job)
    provenance = json.loads((store.run_folder(run_id(run)) / "provenance.json").read_text())
    assert provenance["device"] == provenance["attempts"][0]["machine"]["device"] == "cuda: NVIDIA H200"


# --- Memory ----------------------------------------------------------------------------------------


@pytest.fixture
def memory_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let numbers become NumPy arrays only by `cpu()`, as CUDA's tensors; but not those of generators."""
    to_array = torch.Tensor.numpy

    def moved(tensor: torch.Tensor) -> torch.Tensor:
        copied = tensor.clone()
        copied.is_moved = True  # type: ignore[attr-defined]
        return copied

    def numpy(tensor: torch.Tensor) -> Any:
        if tensor.dtype != torch.uint8 and not hasattr(tensor, "is_moved"):
            raise TypeError("can't convert cuda:0 device type tensor to numpy")
        return to_array(tensor)

    monkeypatch.setattr(torch.Tensor, "cpu", moved)
    monkeypatch.setattr(torch.Tensor, "numpy", numpy)


@pytest.mark.usefixtures("memory_apart")
@pytest.mark.parametrize("case", [*LEARNERS, "normalized sb3", "bits"])
def test_arrays_are_made_of_copies_in_the_cpus_memory(case: str) -> None:
    """The same bits all the same, also from a checkpoint. A GPU's own are tested below."""
    run = run_of(case)
    whole, checkpoints = train(run)
    resumed, _ = train(run, checkpoints[1])
    assert bits(resumed) == bits(whole)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no CUDA device")
@pytest.mark.parametrize("case", LEARNERS)
def test_a_gpu_trains_and_resumes(case: str) -> None:
    run = run_of(case, device="cuda")
    check_environment(run)
    whole, checkpoints = train(run)
    resumed, _ = train(run, checkpoints[1])
    assert whole.status == resumed.status == "done"
    assert "random/cuda" in checkpoints[1].arrays


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no CUDA device")
def test_a_gpu_trains_other_learners() -> None:
    run = make_run({**OPEN, "device": "cuda"})
    check_environment(run)
    assert train_run(run, lambda progress: True).status == "done"
