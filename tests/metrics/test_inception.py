"""Inception: the file is the one, fetched once; crops and features are those of the paper's protocol."""

import hashlib
import http.server
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from torchmetrics.image.fid import FrechetInceptionDistance
from torchmetrics.image.kid import KernelInceptionDistance

from ablate.metrics import features, frechet_distance, inception_file, kernel_distance, load_inception


class SmallNet(torch.nn.Module):
    """Stands for Inception: twelve means of what it is shown, and three corners, so that the cropping is visible."""

    def __init__(self) -> None:
        super().__init__()
        self.num_features = 15

    def forward(self, x: torch.Tensor, return_features: bool = True) -> torch.Tensor:
        assert return_features
        assert x.dtype == torch.uint8
        means = torch.nn.functional.adaptive_avg_pool2d(x[:, :1].double(), (3, 4)).flatten(1)
        corners = torch.stack([x[:, 0, 0, 0], x[:, 1, -1, -1], x[:, 2, 0, -1]], dim=1)
        return torch.cat([means, corners.double()], dim=1)


@pytest.fixture(scope="module")
def small_net(tmp_path_factory):
    path = tmp_path_factory.mktemp("net") / "net.pt"
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(torch.jit.script(SmallNet()), str(path))
    return path


@pytest.fixture
def pinned(small_net, monkeypatch):
    """The small network passes for the one whose digest is known."""
    monkeypatch.setattr(features, "INCEPTION_SHA256", hashlib.sha256(small_net.read_bytes()).hexdigest())
    return small_net


@pytest.fixture
def served(pinned, monkeypatch, tmp_path):
    """The small network on a web server; the list grows by a line for every time it is asked for."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_response(200)
            self.send_header("Content-Length", str(pinned.stat().st_size))
            self.end_headers()
            self.wfile.write(pinned.read_bytes())

        def log_message(self, *_):
            pass

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setattr(features, "INCEPTION_URL", f"http://127.0.0.1:{server.server_port}/some/net.pt")
        yield asked
        server.shutdown()


def test_it_is_fetched_once_and_checked(served, pinned, tmp_path, monkeypatch):
    path = inception_file("download")
    assert path == tmp_path / "cache" / "ablate" / "net.pt"
    assert path.read_bytes() == pinned.read_bytes()
    assert inception_file("download") == path
    assert served == ["/some/net.pt"]
    path.write_bytes(b"cut off")
    with pytest.raises(ValueError, match="SHA-256"):
        inception_file("download")
    path.unlink()
    monkeypatch.setattr(features, "INCEPTION_SHA256", "0" * 64)
    with pytest.raises(ValueError, match="SHA-256"):
        inception_file("download")
    assert not path.exists(), "what is not the network is not kept as it"


def test_no_network_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(features, "INCEPTION_URL", "http://127.0.0.1:9/net.pt")
    with pytest.raises(ConnectionError, match=r"127.0.0.1:9/net.pt cannot be downloaded.*give the path"):
        inception_file("download")


def test_four_crops_of_the_centre(pinned):
    images = np.random.default_rng(0).integers(0, 256, (3, 600, 700)).astype(np.uint8)
    features = load_inception(inception_file(str(pinned)), batch=5)(images)
    assert features.shape == (12, 15)
    top, left = 44, 94
    assert features[4, 12] == images[1, top, left]
    assert features[7, 13] == images[1, top + 511, left + 511]
    assert features[5, 14] == images[1, top, left + 511]


@pytest.mark.filterwarnings("ignore:Metric `Kernel Inception Distance` will save")
def test_fid_and_kid_are_those_of_torchmetrics_with_the_same_network(pinned):
    """torchmetrics runs the network itself, on crops cut here by torch's own centre and four corners."""
    rng = np.random.default_rng(3)
    targets = rng.integers(0, 256, (6, 530, 560)).astype(np.uint8)
    images = np.clip(targets.astype(int) + rng.integers(-40, 60, targets.shape), 0, 255).astype(np.uint8)
    features = load_inception(inception_file(str(pinned)))
    rendered, wanted = features(images), features(targets)

    size = 4 * len(images)
    fid = FrechetInceptionDistance(SmallNet(), input_img_size=(3, 299, 299))
    kid = KernelInceptionDistance(SmallNet(), subsets=1, subset_size=size)
    for metric in (fid, kid):
        metric.used_custom_model = True
        metric.set_dtype(torch.float64)
        for pictures, real in ((targets, True), (images, False)):
            centre = torch.from_numpy(pictures)[:, 9:521, 24:536]
            corners = [
                centre[:, r, c] for r in (slice(299), slice(-299, None)) for c in (slice(299), slice(-299, None))
            ]
            metric.update(torch.stack(corners, 1).flatten(0, 1)[:, None].repeat(1, 3, 1, 1), real=real)
    assert frechet_distance(rendered, wanted) == pytest.approx(float(fid.compute()), rel=1e-4)
    assert kernel_distance(rendered, wanted) == pytest.approx(float(kid.compute()[0]), rel=1e-6)


def test_only_the_network_itself_needs_torch():
    code = "import sys; sys.modules['torch'] = None; from ablate.metrics import *"
    subprocess.run([sys.executable, "-c", code], check=True)
