# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     name: python3
#     display_name: Python 3
# ---

# %% [markdown]
# # From triangles to a B-mode image, in ten pictures
#
# The simulator takes a body made of triangle meshes and a probe pressed on it, and returns what a scanner would show.
# This notebook takes the scene and a test frame of the study that `make sweep` left in `runs/`, renders that frame
# once at the paper's size, and looks at everything on the way. Nothing is trained.

# %%
from contextlib import ExitStack
from types import SimpleNamespace
from unittest.mock import patch

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.collections import LineCollection
from matplotlib.patches import Patch
from scipy.ndimage import maximum_filter1d

from ablate.analysis.body_view import draw_body
from ablate.analysis.tissue_colours import tissue_colours
from ablate.anatomy import bounds_mm
from ablate.config import SceneKind
from ablate.dataset import Part
from ablate.studies.data import build_scene
from ablate.studies.reading import open_study
from ablate.ultrasound import Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound import simulator as stages_of_a_frame
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.point_spread import blur
from ablate.ultrasound.probe import fan_size_mm, sample_depths_mm, scanline_angles, scanlines_in_plane, to_world
from ablate.ultrasound.slices import sample_lines
from ablate.ultrasound.stage_times import STAGES
from ablate.ultrasound.walk import Samples

study = open_study()
if study.settings.scene.kind is SceneKind.pairs:
    raise SystemExit("The pairs of this study were made elsewhere: it has no scene. Run `make sweep`.")
scene, grid = build_scene(study.settings)
pairs, probe, settings = study.data.pairs, study.settings.probe, SimulatorSettings()
tests = pairs.frames(Part.test)
variety = [len(np.unique(labels)) for labels in pairs.read("segmentation", tests)]
frame = int(tests[int(np.argmax(variety))])  # the test frame that shows most tissues
pose = pairs.poses[frame]
triangles = sum(len(structure.mesh.faces) for structure in scene.structures)
print(f"{scene.name}: {len(scene.structures)} structures, {triangles:,} triangles, {len(scene.tissues)} tissues")
print(f"frame {frame} of {study.folder.name}, at {probe.frequency_mhz:g} MHz")

# %% [markdown]
# `Simulator.render` is one call. To see inside it, we note what each of its stages takes and gives while it runs.

# %%
noted: dict[str, SimpleNamespace] = {}


def watching(name, stage):
    def watched(*arguments, **named):
        result = stage(*arguments, **named)
        kept = result.clone() if isinstance(result, torch.Tensor) else result  # later stages work in place
        noted[name] = SimpleNamespace(arguments=arguments, result=kept)
        return result

    return watched


with ExitStack() as watched_stages:
    for name, owner, attribute in STAGES:
        watched_stages.enter_context(patch.object(owner, attribute, watching(name, getattr(owner, attribute))))
    rendered = Simulator(scene, probe, settings).render(pose, seed=study.settings.dataset.seed)
print("\n".join(noted))

# %%
# What all pictures share: colours, the fan's size in mm, and scanlines shown in the fan.
colours = tissue_colours(scene.tissues)
names = [tissue.name.replace("_", " ") for tissue in scene.tissues]
height, width = fan_size_mm(probe)
top = probe.depth_mm - height
extent = (-width / 2, width / 2, probe.depth_mm, top)
to_fan = noted["scan conversion"].arguments[0]  # from (scanlines, samples) to the image of the fan
angles, depths = scanline_angles(probe, settings.scanlines), sample_depths_mm(probe, settings.axial_samples)


def show(axes, picture, title, **how):
    """A picture of the fan, in mm."""
    shown = axes.imshow(picture, extent=extent, **{"cmap": "gray", "interpolation": "antialiased", **how})
    axes.set(title=title, xlabel="mm", ylabel="depth (mm)")
    return shown


def decibel(amplitude, floor_db=-80.0):
    return np.maximum(20 * np.log10(np.maximum(np.asarray(amplitude, float), 1e-12)), floor_db)


def in_fan(lines, outside=np.nan):
    """Lines (scanlines, samples) as an image of the fan."""
    values = np.ascontiguousarray(lines, dtype=np.float32)
    return np.where(to_fan.mask, to_fan(torch.from_numpy(values)), outside)


def tissues_of(axes, labels, columns=1, **where):
    present = [i for i in np.unique(labels) if i < len(names)]
    handles = [Patch(facecolor=colours[i], edgecolor="#888888", lw=0.4, label=names[i]) for i in present]
    axes.legend(handles=handles, frameon=False, fontsize=8, ncols=columns, handlelength=1, **where)


plt.rcParams.update({"figure.dpi": 90, "figure.constrained_layout.use": True, "image.aspect": "equal"})

# %% [markdown]
# ## 1. The mesh
#
# Closed surfaces, one tissue each. Skin, fat and muscle are drawn almost clear, organs half clear, bone opaque. The
# yellow fan is what the probe looks at.

# %%
figure = plt.figure(figsize=(7, 7), layout="none")
space = figure.add_axes((0, 0, 1, 1), projection="3d", proj_type="ortho")
fan = fan_mask(probe, pairs.shape)
draw_body(space, scene, probe, pose, np.where(fan, np.uint8(200), np.uint8(0)), fan, grid.axis)
plt.show()

# %% [markdown]
# ## 2. The slice: segmentation S
#
# Which tissue owns the centre of each pixel. One ray runs down every pixel column through every surface it meets, so
# the edges are exact to the pixel. S is the first of the two maps that the networks read.

# %%
line = int(np.argmax([len(np.unique(labels)) for labels in noted["attenuation, its labels"].result]))
labels = noted["labels of the pixels"].result
figure, axes = plt.subplots(figsize=(9, 5))
show(axes, np.where(fan_mask(probe, labels.shape)[..., None], np.array(colours)[labels], 1.0), "Segmentation S")
radius = probe.radius_mm + np.array([0, probe.depth_mm])
axes.plot(radius * np.sin(angles[line]), radius * np.cos(angles[line]) - probe.radius_mm, "k--", lw=1)
tissues_of(axes, labels[fan_mask(probe, labels.shape)], loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## 3. Who owns a point
#
# Along the dashed line: each bar is where the line is inside one structure. A ray keeps the set of structures it is
# inside of; every surface it crosses puts one in or takes it out. Where several overlap, the one that comes last in
# the scene (here: lowest) owns the point. Which way triangles face plays no part, so badly wound meshes do no harm.

# %%
starts, directions = (part[0] for part in scanlines_in_plane(probe, settings.scanlines, np.zeros(1)))
start, direction = to_world(pose, starts[line]), pose[:3, :3] @ directions[line]
bounds = bounds_mm(structure.mesh for structure in scene.structures)
samples = Samples(depths[0], depths[1] - depths[0], len(depths), np.array([0, 1], np.uint8))
bars = []
for structure, tissue in zip(scene.structures, scene.structure_tissues, strict=True):
    alone = Geometry([structure], bounds, np.zeros(3), radius[1])
    inside = sample_lines(alone, start[None], direction[None], samples)[0][0]
    if inside.any():
        name = structure.mesh.metadata.get("name", structure.tissue.name)
        bars.append((name.replace("_", " "), tissue, inside))
figure, axes = plt.subplots(figsize=(9, 0.9 + 0.28 * len(bars)))
for row, (_, tissue, inside) in enumerate(bars):
    edges = np.flatnonzero(np.diff(inside, prepend=0, append=0)).reshape(-1, 2) * samples.spacing_mm
    pieces = [(begin, end - begin) for begin, end in edges]
    axes.broken_barh(pieces, (row - 0.4, 0.8), facecolors=colours[tissue], lw=0)
owned = noted["attenuation, its labels"].result[line]
strip = (0, probe.depth_mm, len(bars) + 1.2, len(bars) + 0.2)
axes.imshow(np.array(colours)[owned][None], extent=strip, aspect="auto", interpolation="nearest")
axes.set_yticks([*range(len(bars)), len(bars) + 0.7], [*(name for name, _, _ in bars), "owner"], fontsize=8)
axes.set(xlabel="depth along the line (mm)", xlim=(0, probe.depth_mm), ylim=(len(bars) + 1.4, -0.6))
plt.show()

# %% [markdown]
# ## 4. Integral attenuation A
#
# What is left of the pulse's amplitude on its way down each scanline: exp(-sum of the tissues' losses), scaled to [0,
# 1]. Behind bone it drops, behind fluid it stays: A carries the shadows, and is the second map that the networks
# read.

# %%
lost = noted["attenuation, its sum"].result
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), width_ratios=(1.25, 1))
shown = show(left, np.where(to_fan.mask, decibel(rendered.attenuation, -60), np.nan), "A, in dB", cmap="viridis")
figure.colorbar(shown, ax=left, label="dB, one way")
right.plot(depths, decibel(lost[line], -200), "k", lw=1.5)
boundaries = np.flatnonzero(np.diff(owned)) + 1
for piece in np.split(np.arange(len(owned)), boundaries):
    ends = (depths[piece[0]], depths[piece[-1]])
    right.axvspan(*ends, color=colours[owned[piece[0]]], alpha=0.5, lw=0)
right.set(title="Along the dashed line", xlabel="depth (mm)", ylabel="dB, one way", xlim=(0, probe.depth_mm))
tissues_of(right, owned, loc="lower left")
plt.show()

# %% [markdown]
# ## 5. Rays and hits
#
# Paths are drawn at random: at a surface a ray goes on, bent by the speeds of sound (Snell), and may send another one
# back, the more likely the more the surface reflects (Fresnel); one that was turned before does one or the other. Here
# are so few that they can be drawn; blue goes away from the probe, red was turned back.

# %%
few = SimulatorSettings(scanlines=40, rays=6, layers=1, image_shape=(250, 347), path_seed=3)
segments = []
trace, closest = stages_of_a_frame.trace, Geometry.closest


def noting_hits(geometry, origins, directions, reach_mm):
    hits = closest(geometry, origins, directions, reach_mm)
    ends = origins + np.minimum(hits.distance_mm, 200)[:, None] * directions
    segments.append((origins.copy(), ends, hits.structure >= 0))
    return hits


def noting_trace(*arguments):  # labels follow straight lines through the same geometry: only paths are wanted
    with patch.object(Geometry, "closest", noting_hits):
        return trace(*arguments)


with patch.object(stages_of_a_frame, "trace", noting_trace):
    Simulator(scene, probe, few).render(pose)
begins, ends, hit = (np.concatenate(part) for part in zip(*segments, strict=True))
begins, ends = ((points - pose[:3, 3]) @ pose[:3, :3] for points in (begins, ends))  # to the probe's axes
back = ends[:, 2] < begins[:, 2]
figure, axes = plt.subplots(figsize=(9, 5.6))
drawn, all_rays = few.scanlines * few.rays, settings.scanlines * settings.rays * settings.layers
faint = 0.65 + 0.35 * np.array(colours)
inside_fan = fan_mask(probe, labels.shape)
show(axes, np.where(inside_fan[..., None], faint[labels], 1.0), f"{drawn} rays of {all_rays:,}, and where they hit")
for turned, colour in ((False, "#0072b2"), (True, "#d55e00")):
    pieces = np.stack([begins, ends], axis=1)[back == turned][:, :, [0, 2]]
    axes.add_collection(LineCollection(pieces, colors=colour, lw=0.5, alpha=0.6))
axes.plot(*ends[hit][:, [0, 2]].T, "k.", ms=1.5)
axes.set(xlim=extent[:2], ylim=(probe.depth_mm, top - 5))
plt.show()

# %% [markdown]
# ## 6. Surface echoes
#
# Every hit sends an echo back: strong where impedances differ much (bone, gas) and where the surface faces the probe.
# Echoes of all rays are averaged on their scanline, at their depth. They are bright thin lines, and nothing between
# them.

# %%
surfaces = noted["echoes onto lines"].result
figure, axes = plt.subplots(figsize=(8, 4.6))
wider = maximum_filter1d(surfaces, 15, axis=1)  # or pixels would miss most of them
reach = np.ceil(decibel(surfaces.max()) / 10) * 10
shown = show(axes, in_fan(decibel(wider, -120)), "Echoes of surfaces", cmap="inferno", vmin=reach - 60, vmax=reach)
figure.colorbar(shown, ax=axes, label="dB against a perfect mirror")
plt.show()

# %% [markdown]
# ## 7. Scatterers
#
# Tissue is grainy. Each tiny cell of the world may hold a scatterer of random strength and phase; a tissue says how
# many and how strong. Their grains are far finer than what a pulse can resolve. Fluid has none. Shadows already show,
# because what no ray reaches is not lit. At the right a square of them.

# %%
strength = np.hypot(*noted["scatterers"].result.numpy())
middle, deep = settings.scanlines // 2, 0.45 * probe.depth_mm
window = (slice(None), slice(int((deep - 6) / samples.spacing_mm), int((deep + 6) / samples.spacing_mm)))
half_lines = max(2, round(6 / ((probe.radius_mm + deep) * (angles[1] - angles[0]))))
busiest = max(
    range(half_lines, settings.scanlines - half_lines),
    key=lambda k: np.median(strength[k - half_lines : k + half_lines, window[1]]),
)
square = (slice(busiest - half_lines, busiest + half_lines), window[1])
small = (-6, 6, deep + 6, deep - 6)


def show_square(axes, lines, title, **how):
    how = {"cmap": "gray", "aspect": "equal", "interpolation": "nearest", **how}
    axes.imshow(lines[square].T, extent=small, **how)
    axes.set(title=title, xlabel="mm across", ylabel="depth (mm)")


figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), width_ratios=(1.45, 1))
reach = np.percentile(decibel(strength), (30, 99.5))
show(left, in_fan(decibel(strength)), "Strength of scatterers", vmin=reach[0], vmax=reach[1])
where = (probe.radius_mm + deep) * np.sin(angles[busiest])
below = (probe.radius_mm + deep) * np.cos(angles[busiest]) - probe.radius_mm
left.plot(where + 6 * np.array([-1, 1, 1, -1, -1]), below + 6 * np.array([-1, -1, 1, 1, -1]), color="#d55e00", lw=1)
show_square(right, decibel(strength), "12 mm of them")
plt.show()

# %% [markdown]
# ## 8. The point spread
#
# The pulse is short, the beam narrow at its focus and wider elsewhere: a point looks like the three spots at the
# left. Smeared with it, neighbouring scatterers add or cancel, as their phases have it: that is speckle. The echoes
# of surfaces are smeared alike, and added.

# %%
spread = noted["point spread"].arguments[2]
points = torch.zeros(settings.scanlines, settings.axial_samples)
at_mm = (20.0, settings.focus_mm, 130.0)
for depth in at_mm:
    points[middle, int(depth / samples.spacing_mm)] = 1
nothing = torch.zeros(2, *points.shape)
spots = np.hypot(*blur(nothing, points, spread).numpy())
signal = np.hypot(*noted["point spread"].result.numpy())
figure, axes = plt.subplots(1, 4, figsize=(11, 3.6), width_ratios=(1, 1, 1, 1.7))
for each, depth in zip(axes, at_mm, strict=False):
    reach_lines = max(2, round(4 / ((probe.radius_mm + depth) * (angles[1] - angles[0]))))
    row, reach_samples = int(depth / samples.spacing_mm), int(1.5 / samples.spacing_mm)
    spot = spots[middle - reach_lines : middle + reach_lines + 1, row - reach_samples : row + reach_samples]
    each.imshow(spot.T / spot.max(), extent=(-4, 4, 1.5, -1.5), cmap="magma", aspect="auto", interpolation="nearest")
    each.set(title=f"at {depth:g} mm" + ", the focus" * (depth == settings.focus_mm), xlabel="mm across")
axes[0].set_ylabel("mm along")
show_square(axes[3], decibel(signal), "The same 12 mm, smeared")
plt.show()

# %% [markdown]
# ## 9. Envelope, gain and logarithm
#
# The envelope of the signal spans far more than a screen can show, and falls with depth. Time-gain compensation lifts
# what comes from deep, a faint noise is added, and the logarithm puts what is left on 256 grey levels.

# %%
grey = noted["grey levels"].result.numpy()
figure, axes = plt.subplots(1, 3, figsize=(11, 4.2), width_ratios=(1, 1.3, 1))
polar = {"aspect": "auto", "extent": (0, settings.scanlines, probe.depth_mm, 0), "cmap": "gray"}
axes[0].imshow(rendered.envelope, vmax=np.percentile(rendered.envelope, 99.8), **polar)
axes[0].set(title="Envelope", xlabel="scanline", ylabel="depth (mm)")
level = decibel(rendered.envelope[:, busiest] / settings.reference_level, -140)
axes[1].plot(depths, level, color="#999999", lw=0.5, label="envelope")
shown_db = (grey[busiest] / 255 - 1) * settings.dynamic_range_db
axes[1].plot(depths, shown_db, color="#0072b2", lw=0.5, label="with gain and noise, as displayed")
axes[1].axhline(settings.noise_floor_db, color="k", ls="--", lw=0.8, label="noise floor")
axes[1].set(title=f"Scanline {busiest}", xlabel="depth (mm)", ylabel="dB under white", xlim=(0, probe.depth_mm))
axes[1].set_ylim(-125, 10)
axes[1].legend(frameon=False, fontsize=8, loc="lower left")
axes[2].imshow(grey.T, vmin=0, vmax=255, **polar)
axes[2].set(title="Grey levels", xlabel="scanline")
plt.show()

# %% [markdown]
# ## 10. Scan conversion: the B-mode image
#
# Scanlines are put where they belong in the fan, interpolated between neighbours. At the right the same frame as it
# lies in the data set: the study's preset has fewer pixels, scanlines and a longer pulse, so that a laptop can train
# on it.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.7))
show(left, rendered.image, "At the paper's size, {} x {}".format(*settings.image_shape), vmin=0, vmax=255)
show(right, pairs.read("high", [frame])[0], "In the data set, {} x {}".format(*pairs.shape), vmin=0, vmax=255)
plt.show()

# %% [markdown]
# S, A and this image H are one pair of the data set: networks learn to get from S and A to H. `docs/simulator.md`
# tells what is modelled, what is not, and how it was checked.
