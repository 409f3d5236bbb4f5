"""Every engine renders what the network renders, and says what it lacks."""

import gc
import re
import signal
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import Tensor

from ablate.networks import Generator, GeneratorSpec, export_onnx
from ablate.training import Engine, TrainingPrecision, load_generator, missing_for, open_engine, open_exported, train
from support.tiny_training import SETTINGS, SPEC, batch, loader

CPU = torch.device("cpu")
SEED = torch.tensor([3])


def drawn(spec: GeneratorSpec) -> Generator:
    torch.manual_seed(0)
    return Generator(spec).eval()


def cropped(height: int, width: int, size: int) -> dict[str, Tensor]:
    return {name: value[:1, :, :height, :width] for name, value in batch(0, size).items() if value.ndim == 4}


@pytest.mark.parametrize("engine", [Engine.eager, Engine.exported])
def test_a_frame_by_engine_and_precision(engine: Engine, tmp_path: Path) -> None:
    if missing_for(engine, CPU):
        pytest.skip(f"needs {missing_for(engine, CPU)}")
    generator, maps, file = drawn(SPEC), cropped(30, 27, 32), tmp_path / "model.onnx"
    if engine is Engine.exported:
        export_onnx(generator, file, 30, 27)
    with torch.inference_mode():
        expected = generator(maps["segmentation"], maps["attenuation"], noise_seed=SEED)
        other = generator(maps["segmentation"], maps["attenuation"], noise_seed=SEED + 1)
    assert (expected - other).abs().max() > 1e-3
    # bf16 rounds to 8 bits: 2^-9 of a feature's size, ten layers of them.
    for precision, tolerance in ((TrainingPrecision.fp32, 1e-5), (TrainingPrecision.bf16, 10 * 2.0**-9)):
        eager = open_engine(generator, 30, 27, precision, Engine.eager)
        render = eager if engine is Engine.eager else open_exported(generator, file, precision)
        assert render(maps, SEED).shape == (1, 1, 30, 27)
        torch.testing.assert_close(render(maps, SEED).float(), expected, rtol=0, atol=tolerance)
        torch.testing.assert_close(render(maps, SEED + 1).float(), other, rtol=0, atol=tolerance)


@pytest.mark.skipif(missing_for(Engine.exported, CPU) is not None, reason="needs the extra export")
def test_a_signal_is_handled_after_exported_engines_were_freed(tmp_path: Path) -> None:
    """Each core of OpenVINO has a stack for signal handlers; where the first is freed first, its stack stays in use."""
    generator, file = drawn(SPEC), tmp_path / "model.onnx"
    export_onnx(generator, file, 30, 27)
    engines = [open_exported(generator, file) for _ in range(2)]
    while engines:
        del engines[0]
        gc.collect()
    received: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    signal.raise_signal(signal.SIGINT)
    signal.signal(signal.SIGINT, previous)
    assert received == [signal.SIGINT]


@pytest.mark.skipif(missing_for(Engine.exported, CPU) is not None, reason="needs the extra export")
def test_the_documented_export_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "networks.md").read_text()
    example = re.search("## Export.*?```python\n(.*?)```", page, re.DOTALL)
    assert example is not None
    run = tmp_path / "runs" / "quick-fetal" / "sa2h-seed0-0123abcd"
    train(SPEC, replace(SETTINGS, steps=1), loader, run)
    monkeypatch.chdir(tmp_path)
    exec(example[1], {})
    generator = load_generator(run / "last.ckpt")
    maps = {name: torch.rand(1, 1, 384, 128) for name in ("segmentation", "attenuation")}
    image = open_exported(generator, run / "model.onnx", TrainingPrecision.fp32)(maps, SEED)
    with torch.inference_mode():
        torch.testing.assert_close(image, generator(**maps, noise_seed=SEED), rtol=0, atol=1e-3)


def test_what_an_engine_lacks_is_said_before_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_for(Engine.eager, CPU) is None
    assert missing_for(Engine.exported, torch.device("cuda")) == (
        "a CPU: on a GPU, take the exported file to TensorRT or ONNX Runtime"
    )
    monkeypatch.setattr(
        "ablate.training.inference.find_spec", lambda name: None if name == "openvino" else find_spec(name)
    )
    with pytest.raises(RuntimeError, match=r"engine=exported: needs the package openvino: pip install .*export"):
        open_engine(drawn(SPEC), 8, 8, engine=Engine.exported)
