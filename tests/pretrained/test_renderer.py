"""Trained generators: what is loaded renders as the network does by hand, and files come back as they were."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import ablate
from ablate.anatomy import Scene, Tissue, fetal_abdomen, fetal_planes, load_tissues
from ablate.dataset import Encoding, label_values
from ablate.metrics import psnr
from ablate.networks import Generator, GeneratorSpec, Space
from ablate.pretrained import NAMES, OUTSIDE, Renderer, load, save, trained_with, values_of
from ablate.setting import plain
from ablate.ultrasound import (
    Beam,
    ConvexProbe,
    Frame,
    LinearProbe,
    PhasedProbe,
    ScanConverter,
    Simulator,
    SimulatorSettings,
    compensated_attenuation,
    fan_mask,
)

SHAPE, SEED = (64, 88), 5
PROBE = ConvexProbe()
TISSUES = [load_tissues()[name] for name in ("soft_tissue", "bone", "blood")]


@pytest.fixture
def frame() -> Frame:
    rng = np.random.default_rng(0)
    mask = fan_mask(PROBE, SHAPE)
    labels = (mask * rng.integers(1, 4, SHAPE)).astype(np.uint8)
    nothing = np.zeros(SHAPE, np.uint8)
    return Frame(labels, (mask * rng.random(SHAPE)).astype(np.float32), nothing, mask, np.zeros((4, 4), np.float32))


def made(attenuation: str = "integral") -> Renderer:
    torch.manual_seed(1)
    generator = Generator(GeneratorSpec(attenuation=attenuation, depth=2, width=0.1)).eval()
    for parameter in generator.parameters():
        torch.nn.init.normal_(parameter, 0, 0.1)
    values = {tissue.name: (value,) for tissue, value in zip(TISSUES, (-0.25, 1.0, 0.125), strict=True)}
    values[OUTSIDE] = (-1.0,)
    simulator = SimulatorSettings(image_shape=SHAPE, scanlines=12, axial_samples=64, tgc_db_cm_mhz=0.4)
    return Renderer(generator, values, PROBE, simulator, {"study": "none"})


def by_hand(renderer: Renderer, frame: Frame, tissues: list[Tissue], seed: int) -> np.ndarray:
    """The same image pixel by pixel of labels, without the functions of the package that prepare and decode."""
    read = np.full(SHAPE, -1, np.float32)
    for place in zip(*frame.mask.nonzero(), strict=True):
        (read[place],) = renderer.values[tissues[frame.segmentation[place] - 1].name]
    attenuation = frame.attenuation
    if renderer.generator.spec.attenuation == "compensated":
        attenuation = compensated_attenuation(attenuation, PROBE, 0.4)
    name = str(renderer.generator.spec.attenuation).replace("integral", "attenuation")
    maps = {"segmentation": torch.tensor(read)[None, None], name: torch.tensor(attenuation)[None, None]}
    with torch.no_grad():
        image = renderer.generator(**maps, noise_seed=torch.tensor([seed]))[0, 0].numpy()
    return np.where(frame.mask, np.clip(np.rint((image + 1) * 127.5), 0, 255), 0).astype(np.uint8)


@pytest.mark.parametrize("attenuation", ["integral", "compensated"])
def test_an_image_is_what_the_network_gives_by_hand(attenuation: str, frame: Frame) -> None:
    renderer = made(attenuation)
    image = renderer.render(frame, TISSUES, SEED)
    difference = np.abs(image.astype(int) - by_hand(renderer, frame, TISSUES, SEED))
    assert difference.max() <= 1  # fused sums may round the other way
    assert (difference > 0).mean() < 0.01
    assert image.std() > 1
    assert not np.array_equal(image, renderer.render(frame, TISSUES, SEED + 1))


def test_in_beam_space_the_image_is_the_scan_conversion(frame: Frame) -> None:
    """A network that passes one map on, as its output layer may, shows this map on the pixels."""
    renderer = made()
    spec = replace(renderer.generator.spec, space="beam")
    renderer = replace(renderer, generator=Generator(spec).eval())
    with pytest.raises(ValueError, match=r"frame\.beam is None"):
        renderer.render(frame, TISSUES)
    for parameter in renderer.generator.parameters():
        torch.nn.init.zeros_(parameter)
    renderer.generator.network.output.bias.data.fill_(0.5)
    rows, lines = 32, 12
    beam = Beam(np.ones((rows, lines), np.uint8), np.zeros((rows, lines), np.float32))
    image = renderer.render(replace(frame, beam=beam), TISSUES)
    grey = np.full((rows, lines), round((np.tanh(0.5) + 1) * 127.5), np.uint8)
    np.testing.assert_array_equal(image, ScanConverter(PROBE, (rows, lines), SHAPE).to_image(grey))


def test_labels_are_read_by_the_names_of_their_tissues(frame: Frame) -> None:
    """Another order of the labels with the tissues in that order is the same anatomy, so the same image."""
    swapped = replace(frame, segmentation=np.array([0, 3, 1, 2], np.uint8)[frame.segmentation])
    in_that_order = [TISSUES[1], TISSUES[2], TISSUES[0]]
    np.testing.assert_array_equal(made().render(swapped, in_that_order), made().render(frame, TISSUES))


def test_a_file_gives_back_the_same_renderer(frame: Frame, tmp_path: Path) -> None:
    save(made(), tmp_path / "mine.pt")
    back = load(tmp_path / "mine.pt")
    np.testing.assert_array_equal(back.render(frame, TISSUES), made().render(frame, TISSUES))
    assert (back.values, back.probe, back.simulator) == (made().values, PROBE, made().simulator)


def test_a_setting_that_is_no_more_does_not_keep_a_file_from_loading(tmp_path: Path) -> None:
    save(made(), tmp_path / "mine.pt")
    content = torch.load(tmp_path / "mine.pt", weights_only=True)
    content["simulator"]["gone_db"] = -45.0
    torch.save(content, tmp_path / "older.pt")
    assert load(tmp_path / "older.pt").simulator == made().simulator


def test_what_cannot_be_loaded_or_rendered_is_named(frame: Frame, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"sa3h: no trained generator, allowed are .*; did you mean sa2h\?"):
        ablate.load("sa3h")
    (tmp_path / "damaged.pt").write_bytes(b"PK\x03\x04 and nothing else")
    with pytest.raises(ValueError, match=r"damaged\.pt: not a file of a trained generator"):
        load(tmp_path / "damaged.pt")
    with pytest.raises(ValueError, match="tissue 'lung': the generator was trained on soft_tissue, bone, blood"):
        made().render(frame, [*TISSUES[:2], load_tissues()["lung"]])
    for probe in (replace(PROBE, depth_mm=75.0), LinearProbe(width_mm=100.0, depth_mm=150.0)):
        with pytest.raises(ValueError, match=r"another fan than the probe of the training, ConvexProbe\("):
            made().render(replace(frame, mask=fan_mask(probe, SHAPE)), TISSUES)


def test_frames_of_another_probe_are_refused(frame: Frame) -> None:
    """A frame that does not tell its probe is refused where its fan has another shape."""
    image = made().render(frame, TISSUES)
    np.testing.assert_array_equal(made().render(replace(frame, probe=ConvexProbe()), TISSUES), image)
    for probe in (replace(PROBE, frequency_mhz=3.0), replace(PROBE, depth_mm=149.0), LinearProbe()):
        with pytest.raises(ValueError, match=r"the frame is one of .*, the generator was trained with ConvexProbe\("):
            made().render(replace(frame, probe=probe), TISSUES)
    large = 256, 355
    maps = {name: np.zeros(large, np.float32) for name in ("attenuation", "image")}
    for probe in (replace(PROBE, depth_mm=140.0), replace(PROBE, fov_deg=72.0)):
        other = replace(frame, segmentation=np.ones(large, np.uint8), mask=fan_mask(probe, large), **maps)
        with pytest.raises(ValueError, match="another fan"):
            made().render(other, TISSUES)
    scene = Scene((), load_tissues()["liver"], "liver")
    settings = SimulatorSettings.low_quality(scanlines=8, axial_samples=64, image_shape=(16, 24))
    assert Simulator(scene, LinearProbe(), settings).render(np.eye(4)).probe == LinearProbe()


CURVE = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
SEEN = {
    "dynamic_range_db": (40.0, r"dynamic_range_db=60\.0 \(here 40\.0\)"),
    "reference_level": (0.01, r"reference_level=0\.1 \(here 0\.01\)"),
    "noise_level_db": (-110.0, r"noise_level_db=-177\.0 \(here -110\.0\)"),
    "most_gain_db": (
        45.0,
        r"most_gain_db=None \(here 45\.0\), time gain 0 13\.7 .* 96 dB \(here 0 13\.7 .* 45 45 45 dB\)",
    ),
    "scatterer_level_db": (-40.0, r"scatterer_level_db=-50\.0 \(here -40\.0\)"),
    "axial_fwhm_mm": (0.9, r"pulse axial_mm=0\.3 \(here 0\.9\)"),
    "lateral_fwhm_mm": (None, r"pulse lateral_mm=0\.8 \(here 4\.95\)"),  # two pixels
    "depth_mode": ("time_of_flight", r"depth_mode=geometric \(here time_of_flight\)"),
    "tgc_db_cm_mhz": (0.6, r"time gain 0 13\.7 .* 96 dB \(here 0 20\.6 .* 144 dB\)"),
    "time_gain_db": (CURVE, r"time gain 0 13\.7 .* 96 dB \(here 0 1 2 3 4 5 6 7 dB\)"),
    "image_shape": ((32, 44), r"pixels of 2\.\d\d x 2\.\d\d mm \(here 4\.\d\d x 4\.\d\d mm\)"),
    "scanlines": (24, r"rows x scanlines of 32 x 12 \(here 32 x 24\)"),
    "axial_samples": (128, r"rows x scanlines of 32 x 12 \(here 64 x 12\)"),
}
UNSEEN = {
    "elevational_fwhm_mm": 2.45,
    "bandwidth": 0.5,
    "rays": 2,
    "layers": 1,
    "path_seed": 7,
    "precision": "float64",
    "plan": "full",
    "device": "cuda",
}


@pytest.mark.parametrize(("name", "value", "said"), [(name, *case) for name, case in SEEN.items()])
def test_a_frame_of_settings_that_a_network_sees_is_warned_of_by_name(name: str, value: object, said: str) -> None:
    renderer = made()
    here = replace(renderer.simulator, **{name: value})
    assert re.fullmatch(f"trained with {said}", trained_with((PROBE, renderer.simulator), (PROBE, here), Space.beam))


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize(("name", "value"), UNSEEN.items())
def test_what_a_network_does_not_see_is_not_warned_of(name: str, value: object, space: Space) -> None:
    simulator = made().simulator
    assert trained_with((PROBE, simulator), (PROBE, replace(simulator, **{name: value})), space) == ""


def test_a_time_gain_is_compared_as_a_curve_however_it_was_set() -> None:
    simulator = made().simulator
    curve = tuple(np.linspace(0, 2 * 0.4 * PROBE.frequency_mhz * PROBE.depth_mm / 10, 8))
    assert trained_with((PROBE, simulator), (PROBE, replace(simulator, time_gain_db=curve)), Space.beam) == ""
    patient = replace(simulator, tgc="patient", time_gain_db=CURVE)
    still_open = replace(patient, time_gain_db=None)
    assert trained_with((PROBE, patient), (PROBE, still_open), Space.beam) == ""
    assert "time gain 0 1 2" in trained_with((PROBE, patient), (PROBE, simulator), Space.beam)
    assert "(here of each patient)" in trained_with((PROBE, simulator), (PROBE, still_open), Space.beam)


def test_all_differences_of_two_probes_are_named() -> None:
    """The aperture is a value of this probe and of the simulator: neither hides the other."""
    probe, simulator = PhasedProbe(), made().simulator
    other = replace(probe, aperture_mm=15.0, frequency_mhz=3.0)
    said = trained_with((probe, simulator), (other, replace(simulator, aperture_mm=0.4)), Space.image)
    assert "aperture_mm=20.0 (here 15.0), frequency_mhz=2.5 (here 3.0)" in said
    assert "aperture_mm=0.2 (here 0.4)" in said


def test_a_rendering_warns_once_of_a_simulators_frame_and_not_of_one_made_elsewhere(frame: Frame) -> None:
    """Warnings are errors in tests, so frames as those of the training, and of unknown settings, are quiet."""
    renderer = made()
    scene = Scene((), TISSUES[0], "soft tissue")
    settings = replace(renderer.simulator, rays=1, layers=1)
    of_training = Simulator(scene, PROBE, settings).render(np.eye(4))
    assert of_training.simulator == settings
    image = renderer.render(of_training, TISSUES)
    renderer.render(frame, TISSUES)
    dark = Simulator(scene, PROBE, replace(settings, dynamic_range_db=40.0, reference_level=1.0)).render(np.eye(4))
    with pytest.warns(UserWarning, match=r"dynamic_range_db=60\.0 \(here 40\.0\), reference_level=0\.1") as said:
        np.testing.assert_array_equal(renderer.render(dark, TISSUES), image)
    assert len(said) == 1
    assert Path(said[0].filename).name == Path(__file__).name, "it points at who renders"


def test_labels_without_a_tissue_and_tissues_of_other_properties_are_refused(frame: Frame) -> None:
    with pytest.raises(ValueError, match="the frame has a label 3, and there are 2 tissues"):
        made().render(frame, TISSUES[:2])
    of_properties = values_of(TISSUES, label_values(TISSUES, Encoding.properties))
    renderer = replace(made(), generator=Generator(made().generator.spec, labels=3).eval(), values=of_properties)
    assert renderer.render(frame, TISSUES).shape == SHAPE
    for changed in ({"scatterer_sd": 2.0}, {"impedance_mrayl": 1.5}):
        with pytest.raises(ValueError, match="tissue 'blood': its properties are not those of the training"):
            renderer.render(frame, [*TISSUES[:2], replace(TISSUES[2], **changed)])


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_generator_has_the_components_that_its_file_names(name: str) -> None:
    """Components that are newer than the file are off."""
    content = torch.load(Path(ablate.__file__).parent / "pretrained" / f"{name}.pt", weights_only=True)
    generator = load(name).generator
    assert content["spec"].items() <= plain(generator.spec).items()
    assert content["labels"] == generator.labels


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_generator_renders_the_built_in_anatomy(name: str) -> None:
    """It is nearer to the target than with the labels of two tissues exchanged, and than with other scatterers."""
    renderer, scene = ablate.load(name), fetal_abdomen(160_000)
    simulator, pose = Simulator(scene, renderer.probe, renderer.simulator), fetal_planes()["abdomen"]
    frame = simulator.render(pose, seed=0)
    image = renderer.render(frame, scene.tissues)
    tissues = list(scene.tissues)
    names = [tissue.name for tissue in tissues]
    soft, fluid = names.index("soft_tissue"), names.index("amniotic_fluid")
    tissues[soft], tissues[fluid] = tissues[fluid], tissues[soft]
    assert psnr(image, frame.image, frame.mask) > 3 + psnr(renderer.render(frame, tissues), frame.image, frame.mask)
    other = replace(frame, beam=replace(frame.beam, grain=simulator.grain(pose, seed=1)))
    elsewhere = renderer.render(other, scene.tissues)
    assert psnr(image, frame.image, frame.mask) > 1 + psnr(elsewhere, frame.image, frame.mask)


@pytest.fixture(scope="module")
def by_lattice() -> dict[tuple[int, int], tuple[float, float]]:
    """PSNR of the shipped SA2H, and with the grain of another seed, by anatomy and seed, mean over standard planes."""
    renderer = load("sa2h")
    scores = {}
    for anatomy in (0, 5):
        scene, poses = fetal_abdomen(40_000, anatomy), list(fetal_planes(anatomy).values())[:5]
        simulator = Simulator(scene, renderer.probe, renderer.simulator, poses=poses)
        for seed in (0, 7, 123):
            right, wrong = [], []
            for pose in poses:
                frame = simulator.render(pose, seed)
                elsewhere = replace(frame, beam=replace(frame.beam, grain=simulator.grain(pose, seed + 1)))
                images = (renderer.render(one, scene.tissues) for one in (frame, elsewhere))
                of_right, of_wrong = (psnr(frame.image, image, frame.mask) for image in images)
                right.append(of_right)
                wrong.append(of_wrong)
            scores[anatomy, seed] = float(np.mean(right)), float(np.mean(wrong))
    return scores


def test_scatterers_and_bodies_that_no_training_saw_are_rendered_as_well(by_lattice) -> None:
    """Seed 0 and anatomy 0 are those of the training."""
    for anatomy in (0, 5):
        of_seeds = [by_lattice[anatomy, seed][0] for seed in (0, 7, 123)]
        assert np.ptp(of_seeds) < 0.25, "of five frames"
    assert by_lattice[5, 0][0] == pytest.approx(by_lattice[0, 0][0], abs=0.4), "other frames"


def test_the_grain_of_other_scatterers_is_told_apart(by_lattice) -> None:
    """A positive control: with the scatterers of another seed the image is that much farther from the target."""
    for right, wrong in by_lattice.values():
        assert right > wrong + 1.5


@pytest.mark.parametrize("name", NAMES)
def test_tissues_that_are_younger_than_a_training_are_read_as_their_neighbours(name: str) -> None:
    """By the order of brightness as the next darker one, by properties as themselves."""
    values = load(name).values
    assert values.keys() - {OUTSIDE} == load_tissues().keys()
    if len(values[OUTSIDE]) == 1:
        neighbours = {"spleen": "liver", "pancreas": "wharton_jelly", "bowel_wall": "muscle"}
        assert all(values[younger] == values[older] for younger, older in neighbours.items())
    else:
        own = label_values([load_tissues()["spleen"]], Encoding.properties)[1]
        np.testing.assert_allclose(values["spleen"], own)
