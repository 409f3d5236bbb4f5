"""The exported file against the network itself, computed by the standard's reference and by a runtime."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from ablate.networks import Generator, GeneratorSpec, conditions, export_onnx, map_channels
from ablate.networks.layers import convolutions
from ablate.training.inference import openvino_core
from ablate.ultrasound import ConvexProbe, ScanConverter
from support.variants import BEAM, BEAM_LABELS, UNET

onnx = pytest.importorskip("onnx")
pytest.importorskip("openvino")

VARIANTS = {
    "sa2h": {"noise_start": 0.5},
    "sa2h-att": {"attenuation": "none", "depth": 1},
    "concat and conv": {"concat": "input", "upsampling": "transposed", "noise": "input"},
    "lsa2h": {**UNET, "extra_input": "low"},
    "beam": BEAM,
}
SIZE = (13, 30)


def drawn(name: str) -> Generator:
    torch.manual_seed(0)
    labels = BEAM_LABELS if name.startswith("beam") else 1
    return Generator(GeneratorSpec(**{"depth": 2, "width": 0.1, **VARIANTS[name]}), labels)


def inputs_of(generator: Generator) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    random = torch.Generator().manual_seed(1)
    channels = {name: map_channels(name, generator.labels) for name in conditions(generator.spec)}
    maps = {name: torch.rand(1, count, *SIZE, generator=random) for name, count in channels.items()}
    return maps, generator.draw_noise(torch.tensor([5]), *SIZE)


def rounding(generator: Generator) -> float:
    """What two orders of summation may differ by, in standard deviations of the features.

    A float32 sum of K terms is off by about sqrt(K) 2^-24 of its size, which instance norm makes 1, and L layers
    by sqrt(L) times as much; five standard deviations of that.
    """
    layers = convolutions(generator)
    terms = max(layer.in_channels * layer.kernel_size[0] ** 2 for layer in layers)
    return 5 * (len(layers) * terms) ** 0.5 * 2.0**-24


@pytest.mark.parametrize("name", VARIANTS)
def test_the_file_computes_what_the_network_computes(name: str, tmp_path: Path) -> None:
    from onnx.reference import ReferenceEvaluator

    generator, path = drawn(name), tmp_path / "model.onnx"
    export_onnx(generator, path, *SIZE)
    assert list(tmp_path.iterdir()) == [path]
    assert generator.training
    maps, fields = inputs_of(generator)
    given = {name: value.numpy() for name, value in {**maps, **fields}.items()}
    with torch.no_grad():
        expected = generator.render(maps, fields).numpy()
        seeded = generator(**maps, noise_seed=torch.tensor([5])).numpy()
    np.testing.assert_array_equal(expected, seeded)
    tolerance = rounding(generator)
    assert tolerance < 3e-5
    reference = ReferenceEvaluator(str(path)).run(None, given)[0]
    runtime = openvino_core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    np.testing.assert_allclose(reference, expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(runtime(given)[0], expected, rtol=0, atol=tolerance)
    assert expected.std() > 100 * tolerance
    # Noise that is zero is noise switched off.
    given.update({name: np.zeros_like(given[name]) for name in fields})
    with torch.no_grad():
        quiet = generator(**maps).numpy()
    np.testing.assert_allclose(runtime(given)[0], quiet, rtol=0, atol=tolerance)
    assert np.allclose(expected, quiet, atol=tolerance) is (name in ("sa2h-att", "lsa2h"))

    model = onnx.load(path)
    assert [node.name for node in model.graph.input] == [*conditions(generator.spec), *generator.noise_sizes(*SIZE)]
    assert [node.name for node in model.graph.output] == ["image"]
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 18)]
    metadata = {entry.key: json.loads(entry.value) for entry in model.metadata_props}
    assert metadata == {"spec": asdict(generator.spec), "labels": generator.labels}
    # Nothing that a runtime may lack, TensorRT among them; and what each variant does without.
    operations = {node.op_type for node in model.graph.node}
    standard = {"Add", "Concat", "Conv", "ConvTranspose", "InstanceNormalization", "LeakyRelu", "Mul"}
    assert operations <= standard | {"Pad", "Relu", "Resize", "Slice", "Split", "Tanh"}
    has_means = generator.spec.concat == "every_level" and len(maps) > 1
    pooling = [tuple(weights.dims) for weights in model.graph.initializer if weights.dims[1:] == [1, 2, 2]]
    assert bool(pooling) is has_means
    assert ("Mul" in operations) is (generator.spec.noise == "inject")


def test_the_file_may_contain_the_scan_conversion(tmp_path: Path) -> None:
    """As the simulator's own scan converter does it; a network's output in [-1, 1] is no grey level yet."""
    generator, path, converter = drawn("beam"), tmp_path / "model.onnx", ScanConverter(ConvexProbe(), SIZE, (40, 55))
    export_onnx(generator, path, *SIZE, converter.places)
    maps, fields = inputs_of(generator)
    with torch.no_grad():
        expected = converter.to_image(generator.render(maps, fields)[0, 0].numpy())
    runtime = openvino_core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    image = runtime({name: value.numpy() for name, value in {**maps, **fields}.items()})[0][0, 0]
    np.testing.assert_allclose(image[converter.mask], expected[converter.mask], rtol=0, atol=2e-5)
    assert (image[~converter.mask] == -1).all()
    with pytest.raises(ValueError, match=r"places: allowed with model\.space=beam, not image"):
        export_onnx(drawn("sa2h"), path, *SIZE, converter.places)


@pytest.mark.parametrize("package", ["onnx", "onnxscript"])
def test_a_missing_package_is_named_with_what_installs_it(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"export needs the package {package}: pip install .*export\]'"):
        export_onnx(drawn("sa2h"), tmp_path / "model.onnx", *SIZE)


def test_an_export_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model.onnx"
    path.write_text("old")

    def full(_model: object, unfinished: Path) -> None:
        unfinished.write_text("half")
        raise OSError("no space left on device")

    made = SimpleNamespace(model_proto=onnx.ModelProto())
    monkeypatch.setattr(torch.onnx, "export", lambda *_, **__: made)
    monkeypatch.setattr(onnx.checker, "check_model", lambda *_, **__: None)
    monkeypatch.setattr(onnx, "save", full)
    with pytest.raises(OSError, match="no space left"):
        export_onnx(drawn("sa2h-att"), path, *SIZE)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
