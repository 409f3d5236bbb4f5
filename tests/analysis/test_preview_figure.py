"""What the picture of a frame shows lies where it is, in 3-D and on the fan."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from ablate.analysis import preview_figure
from ablate.analysis.figures import scene_parts
from ablate.analysis.figures.body_view import draw_body, image_quads
from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.analysis.figures.style import house_style
from ablate.anatomy import Scene, SiteGrid, Structure, Tissue, load_tissues
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import fan_outline, to_world

TISSUES = load_tissues()
PROBE = ConvexProbe()


def sphere(radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(4, radius=radius)
    ball.apply_translation(centre)
    return ball


def pose_at(origin: tuple[float, float, float], z: tuple[float, float, float], x: tuple[float, float, float]):
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, origin
    return pose


def unit(*vector: float) -> tuple[float, float, float]:
    x, y, z = np.asarray(vector) / np.linalg.norm(vector)
    return x, y, z


FRONT = pose_at((0, -60, 0), (0, 1, 0), (1, 0, 0))


def test_the_probe_is_closed_and_lies_behind_its_fan() -> None:
    housing = scene_parts.probe_body(PROBE, FRONT)
    assert housing.is_watertight
    assert housing.bounds[1, 1] == pytest.approx(-60, abs=1e-6)  # the middle of the face
    assert housing.extents[0] == pytest.approx(2 * 40 * np.sin(np.deg2rad(35)), abs=1e-6)
    radii = np.linalg.norm(to_world(FRONT, fan_outline(PROBE))[:, :2] - (0, -100), axis=1)
    assert {round(float(r), 6) for r in radii} == {40.0, 190.0}


def test_every_pixel_of_the_image_is_painted_where_it_was_seen() -> None:
    shape = 40, 56
    image = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    mask = fan_mask(PROBE, shape)
    corners, colours = image_quads(PROBE, FRONT, image, mask)
    width, height = 2 * 190 * np.sin(np.deg2rad(35)), 190 - 40 * np.cos(np.deg2rad(35))
    x, z = np.meshgrid((np.arange(56) + 0.5) / 56 * width - width / 2, (np.arange(40) + 0.5) / 40 * height)
    sag = 40 * (1 - np.cos(np.deg2rad(35)))
    points = np.stack([x, z - sag - 60, 0 * x], axis=-1)  # z of the probe is y of the world
    np.testing.assert_allclose(corners.mean(axis=1), points[mask], atol=1e-9)
    np.testing.assert_allclose(colours[:, 0], image[mask] / 255, atol=1e-6)


def body(*more: Structure) -> Scene:
    box = trimesh.creation.box(bounds=((-100, -68, -90), (100, 90, 90)))
    return Scene((Structure(box, TISSUES["muscle"]), *more), TISSUES["coupling_gel"], "box")


@pytest.mark.parametrize(("axis", "behind"), [((0, 0, 1), -25), ((0, 0, -1), 25), ((1, 0, 0), 25), ((0, -1, 0), 25)])
def test_the_picture_lies_on_the_axes_and_the_body_is_upright(axis: tuple[float, float, float], behind: float) -> None:
    """A bone beside the fan, behind its plane, is drawn at the pixel that the axes project its middle to."""
    where = np.array([-75.0, -40.0, behind])
    figure = Figure(figsize=(4, 4))
    canvas = FigureCanvasAgg(figure)
    space = figure.add_axes((0, 0, 1, 1), projection="3d", proj_type="ortho")
    shape = 20, 28
    bone = Structure(sphere(12, tuple(where)), TISSUES["bone"])
    image = np.zeros(shape, np.uint8)
    draw_body(space, body(bone), PROBE, FRONT, image, fan_mask(PROBE, shape), axis)
    assert (space.get_proj()[:2, :3] @ axis)[1] > 0
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba()).astype(int)

    def colour_at(point: np.ndarray) -> np.ndarray:
        flat = space.get_proj() @ [*point, 1]
        column, up = space.transData.transform(flat[:2] / flat[3])
        return pixels[round(len(pixels) - up), round(column), :3]

    across = np.linalg.inv(space.get_proj()[:3, :3])[:, 0]  # a step to the right in the picture
    across *= 1 / np.linalg.norm(across)
    for step in (-17, -9, 0, 9, 17):
        _, green, blue = colour_at(where + step * across)
        assert (green > blue + 5) == (abs(step) < 12), "ivory is yellowish as nothing else in the picture"


def test_bone_gas_blood_and_fluids_have_their_own_colours() -> None:
    every = dict(zip(TISSUES, tissue_colours(list(TISSUES.values())), strict=True))
    apart = [np.linalg.norm(np.subtract(a, b)) for a, b in itertools.combinations(every.values(), 2)]
    assert min(apart) > 0.05
    for fluid in ("amniotic_fluid", "urine", "csf"):
        assert np.argmax(every[fluid]) == 2
    others = [Tissue("gel"), Tissue("air", impedance_mrayl=0.0004), TISSUES["thalamus"], Tissue("tumour")]
    colours = tissue_colours(others)
    assert colours[1:3] == [scene_parts.GAS, every["thalamus"]]
    assert tissue_colours([Tissue("tumour"), *others[::-1]])[1:3] == [colours[3], colours[2]]


def test_the_figure_holds_body_image_and_segmentation(tmp_path: Path) -> None:
    shape = 100, 139
    mask = fan_mask(PROBE, shape)
    image = (200 * mask).astype(np.uint8)
    labels, path = (2 * mask).astype(np.uint8), tmp_path / "data" / "preview_3.png"
    assert preview_figure(path, "frame 3", body(), PROBE, FRONT, image, labels, SiteGrid()) == path
    assert list(path.parent.iterdir()) == [path]
    picture = imread(path)[..., :3]
    assert picture.shape[1] == pytest.approx(1432, abs=1)
    upper = picture[60:350, 1000:1380]
    assert (np.abs(upper - 200 / 255).max(axis=-1) < 0.01).mean() > 0.4  # the fan fills half its box
    lower = picture[410:700, 1000:1380]
    muscle = tissue_colours(body().tissues)[1]
    assert (np.abs(lower - muscle).max(axis=-1) < 0.01).mean() > 0.4


def test_nothing_is_cut_off_or_written_over_whatever_the_body_and_the_view(tmp_path: Path) -> None:
    """A margin of the page is white all around, and so is what lies between the body and the images."""
    shape = 40, 56
    mask = fan_mask(PROBE, shape)
    image = (200 * mask).astype(np.uint8)
    others = [Structure(sphere(3, (5 * i, 0, 0)), tissue) for i, tissue in enumerate(list(TISSUES.values())[:28])]
    labels = mask * (1 + np.arange(40 * 56).reshape(shape) % 28).astype(np.uint8)
    turned = pose_at((60, -60, -60), unit(-1, 1, 1), unit(1, 1, 0))
    flat = trimesh.creation.box(bounds=((-300, -68, -60), (300, 90, 60)))
    tall = trimesh.creation.box(bounds=((-60, -68, -400), (60, 90, 400)))
    for number, (mesh, pose) in enumerate(itertools.product((flat, tall), (FRONT, turned))):
        scene = Scene((Structure(mesh, TISSUES["muscle"]), *others), TISSUES["coupling_gel"], "box")
        assert len(scene.tissues) >= 28
        path = tmp_path / f"{number}.png"
        preview_figure(path, "frame", scene, PROBE, pose, image, labels, SiteGrid())
        dark = imread(path)[..., :3].min(axis=-1) < 0.5
        height, width = dark.shape
        assert not any(edge.any() for edge in (dark[:3], dark[-3:], dark[:, :3], dark[:, -3:]))
        assert not dark[: round(0.85 * height), round(0.605 * width) : round(0.615 * width)].any()


@pytest.mark.parametrize("name", ["a$\\frac{b$", "$", "$x$", "5 $ or 6 $", "$\\nope$", "$_$"])
def test_a_dollar_in_a_name_is_a_dollar(name: str) -> None:
    """Wherever the house's figures write what a user has named."""
    with house_style():
        figure = Figure()
        axes = figure.add_subplot(title=name, xlabel=name)
        axes.plot([0, 1], label=name)
        axes.legend()
        axes.text(0, 0, name)
        FigureCanvasAgg(figure).draw()
        assert not axes.title.get_parse_math()
