# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     name: python3
#     display_name: Python 3
# ---

# %% [markdown]
# # From triangles to a B-mode image, in ten pictures
#
# The simulator takes a body of triangle meshes and a probe that is pressed on it. It returns the image that a scanner
# would show. This notebook takes the scene and one test frame of the study that `make sweep` left in `runs/`. It
# renders this frame once at the paper's size and shows all steps. Nothing is trained.

# %%
import copy
from types import SimpleNamespace
from unittest.mock import patch

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Patch
from scipy.ndimage import maximum_filter1d

from ablate.analysis.figures.body_view import draw_body
from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.anatomy import bounds_mm
from ablate.dataset import Part
from ablate.sources.source import source_of
from ablate.study.opened import found_study
from ablate.ultrasound import Simulator, SimulatorSettings, fan_mask
from ablate.ultrasound.imaging.point_spread import blur
from ablate.ultrasound.probe import fan_of, sample_depths_mm, scanline_positions, scanlines_in_plane, to_world
from ablate.ultrasound.stages import Stage, observe_stages
from ablate.ultrasound.surfaces.embree import asked_packet, asked_ray
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.surfaces.line_walk import Samples
from ablate.ultrasound.surfaces.slices import sample_lines
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport import tracing
from ablate.ultrasound.transport.advance import advance, grown
from ablate.ultrasound.transport.rays import MAX_ROWS

study = found_study()
run = study.usable.runs[0]  # scene, probe and simulator are the same for all
source = source_of(run.training.settings)
if not source.has_scene:
    raise SystemExit("The pairs of this study were made elsewhere: it has no scene. Run `make sweep`.")
scene, grid = source.scene()
pairs, probe = run.training.data_set.pairs, run.training.settings.probe
settings = SimulatorSettings(noise_level_db=-110, most_gain_db=45)  # noise and gain of a scanner, all else the paper's
tests = pairs.frames(Part.test)
variety = [len(np.unique(labels)) for labels in pairs.read("segmentation", tests)]
frame = int(tests[int(np.argmax(variety))])  # the test frame that shows most tissues
pose = pairs.poses[frame]
triangles = sum(len(structure.mesh.faces) for structure in scene.structures)
print(f"{scene.name}: {len(scene.structures)} structures, {triangles:,} triangles, {len(scene.tissues)} tissues")
print(f"frame {frame} of {study.folder.name}, at {probe.frequency_mhz:g} MHz")

# %% [markdown]
# `Simulator.render` is one call. To show its steps, this notebook records the input and the output of each step.

# %%
noted: dict[str, SimpleNamespace] = {}


def note_stage(stage, function, arguments):
    result = function(*arguments)
    kept = copy.deepcopy(result) if isinstance(result, np.ndarray | tuple) else result  # later stages work in place
    noted[stage] = SimpleNamespace(arguments=arguments, result=kept)
    return result


with observe_stages(note_stage):
    rendered = Simulator(scene, probe, settings).render(pose, seed=run.training.settings.dataset.seed)
print("\n".join(noted))

# %%
# What all pictures share: colours, the fan's size in mm, and scanlines shown in the fan.
colours = tissue_colours(scene.tissues)
names = [tissue.name.replace("_", " ") for tissue in scene.tissues]
height, width = fan_of(probe).size_mm
top = probe.depth_mm - height
extent = (-width / 2, width / 2, probe.depth_mm, top)
to_fan, beam = noted[Stage.scan_conversion].arguments  # from (rows, scanlines) to the image of the fan
beam_rows = len(beam)
angles, depths = scanline_positions(probe, settings.scanlines), sample_depths_mm(probe, settings.axial_samples)


def show(axes, picture, title, **how):
    """A picture of the fan, in mm."""
    shown = axes.imshow(picture, extent=extent, **{"cmap": "gray", "interpolation": "antialiased", **how})
    axes.set(title=title, xlabel="mm", ylabel="depth (mm)")
    return shown


def decibel(amplitude, floor_db=-80.0):
    return np.maximum(20 * np.log10(np.maximum(np.asarray(amplitude, float), 1e-12)), floor_db)


def in_fan(lines, outside=np.nan):
    """Lines (scanlines, samples) as an image of the fan."""
    rows = np.asarray(lines, np.float32).T.reshape(beam_rows, -1, len(lines)).mean(axis=1)  # some samples make a row
    return np.where(to_fan.mask, to_fan.to_image(rows), outside)


def tissues_of(axes, labels, columns=1, **where):
    present = [i for i in np.unique(labels) if i < len(names)]
    handles = [Patch(facecolor=colours[i], edgecolor="#888888", lw=0.4, label=names[i]) for i in present]
    axes.legend(handles=handles, frameon=False, fontsize=8, ncols=columns, handlelength=1, **where)


plt.rcParams.update({"figure.dpi": 90, "figure.constrained_layout.use": True, "image.aspect": "equal"})

# %% [markdown]
# ## 1. The mesh
#
# Each structure is a closed surface with one tissue. Skin, fat and muscle are drawn nearly transparent, organs half
# transparent, and bone opaque. The yellow fan is the image area of the probe.

# %%
figure = plt.figure(figsize=(7, 7), layout="none")
space = figure.add_axes((0, 0, 1, 1), projection="3d", proj_type="ortho")
fan = fan_mask(probe, pairs.shape)
draw_body(space, scene, probe, pose, np.where(fan, np.uint8(200), np.uint8(0)), fan, grid.axis)
plt.show()

# %% [markdown]
# ## 2. The slice: segmentation S
#
# S says which tissue owns the centre of each pixel. One ray per pixel column crosses every surface, so the edges are
# exact to the pixel. S is the first of the two maps that the networks read.

# %%
line = int(np.argmax([len(np.unique(labels)) for labels in noted[Stage.attenuation_labels].result]))
labels = np.maximum(noted[Stage.pixel_labels].result, 1) - 1  # there 0 is outside the fan, and 1 the first tissue
figure, axes = plt.subplots(figsize=(9, 5))
show(axes, np.where(fan_mask(probe, labels.shape)[..., None], np.array(colours)[labels], 1.0), "Segmentation S")
radius = probe.radius_mm + np.array([0, probe.depth_mm])
axes.plot(radius * np.sin(angles[line]), radius * np.cos(angles[line]) - probe.radius_mm, "k--", lw=1)
tissues_of(axes, labels[fan_mask(probe, labels.shape)], loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## 3. The owner of a point
#
# The bars show where the dashed line is inside each structure. A ray keeps the set of structures that contain its
# current point. Each surface that it crosses adds a structure to the set or removes it. If several structures contain
# a point, the last one in the scene owns the point (here the lowest bar). The orientation of the triangles plays no
# role, so meshes with wrong orientation do no harm.

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
owned = noted[Stage.attenuation_labels].result[line]
strip = (0, probe.depth_mm, len(bars) + 1.2, len(bars) + 0.2)
axes.imshow(np.array(colours)[owned][None], extent=strip, aspect="auto", interpolation="nearest")
axes.set_yticks([*range(len(bars)), len(bars) + 0.7], [*(name for name, _, _ in bars), "owner"], fontsize=8)
axes.set(xlabel="depth along the line (mm)", xlim=(0, probe.depth_mm), ylim=(len(bars) + 1.4, -0.6))
plt.show()

# %% [markdown]
# ## 4. Integral attenuation A
#
# A says how much of the pulse's amplitude is left along each scanline. It is exp(-sum of the losses of the tissues),
# scaled to [0, 1]. A is small behind bone and stays large behind fluid. It contains the shadows, and is the second
# map that the networks read.

# %%
lost = noted[Stage.attenuation_sum].result
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), width_ratios=(1.25, 1))
shown = show(left, np.where(to_fan.mask, decibel(rendered.attenuation, -60), np.nan), "A, in dB", cmap="viridis")
figure.colorbar(shown, ax=left, label="dB, one way")
right.plot(depths.reshape(beam_rows, -1).mean(axis=1), decibel(lost[line], -200), "k", lw=1.5)  # samples make a row
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
# Paths are random. A surface refracts a ray (Snell's law) and may also emit a reflected ray. The stronger the
# reflection (Fresnel's equation), the more likely is a reflected ray. A ray that was reflected before is either
# transmitted or reflected. This picture uses few rays, so that they can be drawn. Blue rays go away from the probe,
# and red rays come back.

# %%
few = SimulatorSettings(scanlines=40, rays=6, layers=1, image_shape=(250, 347), path_seed=3)
segments = []


def note_paths(stage, function, arguments):
    if stage is not Stage.tracing:
        return function(*arguments)
    geometry = arguments[0]

    def one_by_one(address, arrays, n, received, view, table, rows, nodes):
        """What `bounces` does, with a note of where each ray begins and ends."""
        rays, inside, echoes = arrays
        while n and (rows >= MAX_ROWS or (rays["interfaces"][:n] < rows).all()):
            origins, directions = (np.ascontiguousarray(rays[name][:n]) for name in ("origin", "direction"))
            hits = geometry.closest(origins, directions, np.ascontiguousarray(rays["reach_mm"][:n]))
            ends = origins + np.minimum(hits.distance_mm, 200)[:, None] * directions
            segments.append((origins, ends, hits.structure >= 0))
            rays, inside, echoes = grown(rays, 2 * n), grown(inside, 2 * n), grown(echoes, received + n)
            embree = address, asked_ray(), asked_packet()
            n, count = advance(embree, rays, inside, echoes[received:], n, view, table, nodes)
            received += count
        return (rays, inside, echoes), n, received

    with patch.object(tracing, "bounces", one_by_one):
        return function(*arguments)


with observe_stages(note_paths):
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
# ## 6. Echoes of surfaces
#
# Every hit sends an echo to the probe. The echo is strong if the impedances differ much (bone, gas) and if the
# surface faces the probe. The echoes of all rays of a scanline are averaged at their depth. The result is thin bright
# lines with nothing between them.

# %%
surfaces = noted[Stage.point_spread].arguments[1]  # the echoes of all rays, before they are blurred
figure, axes = plt.subplots(figsize=(8, 4.6))
wider = maximum_filter1d(surfaces, 15, axis=1)  # or pixels would miss most of them
reach = np.ceil(decibel(surfaces.max()) / 10) * 10
shown = show(axes, in_fan(decibel(wider, -120)), "Echoes of surfaces", cmap="inferno", vmin=reach - 60, vmax=reach)
figure.colorbar(shown, ax=axes, label="dB relative to a perfect mirror")
plt.show()

# %% [markdown]
# ## 7. Scatterers
#
# Tissue is grainy. Each tiny cell of the world may contain a scatterer of random strength and phase. The tissue says
# how many scatterers there are and how strong they are. Their grains are much finer than the pulse can resolve. Fluid
# has no scatterers. Shadows are already visible, because rays do not insonify these places. The right picture shows a
# small square of scatterers.

# %%
strength = np.hypot(*np.asarray(noted[Stage.scatterers].result))
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
show_square(right, decibel(strength), "12 mm of scatterers")
plt.show()

# %% [markdown]
# ## 8. The point spread function
#
# The pulse is short. The beam is narrow at its focus and wider elsewhere. The three spots at the left are the images
# of single points. When scatterers are blurred in this way, neighbouring scatterers add up or cancel, depending on
# their phases. The result is speckle. The echoes of surfaces are blurred in the same way and added.

# %%
spread = noted[Stage.point_spread].arguments[2]
points = np.zeros((settings.scanlines, settings.axial_samples), np.float32)
at_mm = (20.0, settings.focus_mm, 130.0)
for depth in at_mm:
    points[middle, int(depth / samples.spacing_mm)] = 1
nothing = np.zeros((2, *points.shape), np.float32)
spots = np.hypot(*np.asarray(blur(nothing, points, spread)))
signal = np.hypot(*np.asarray(noted[Stage.point_spread].result))
figure, axes = plt.subplots(1, 4, figsize=(11, 3.6), width_ratios=(1, 1, 1, 1.7))
for each, depth in zip(axes, at_mm, strict=False):
    reach_lines = max(2, round(4 / ((probe.radius_mm + depth) * (angles[1] - angles[0]))))
    row, reach_samples = int(depth / samples.spacing_mm), int(1.5 / samples.spacing_mm)
    spot = spots[middle - reach_lines : middle + reach_lines + 1, row - reach_samples : row + reach_samples]
    each.imshow(spot.T / spot.max(), extent=(-4, 4, 1.5, -1.5), cmap="magma", aspect="auto", interpolation="nearest")
    each.set(title=f"at {depth:g} mm" + ", the focus" * (depth == settings.focus_mm), xlabel="mm across")
axes[0].set_ylabel("mm along")
show_square(axes[3], decibel(signal), "The same 12 mm, blurred")
plt.show()

# %% [markdown]
# ## 9. Envelope, gain and logarithm
#
# The envelope of the signal has a larger range than a screen can show, and it falls with depth. Time-gain
# compensation amplifies deep echoes. Weak noise is added. The logarithm maps the result to 256 grey levels.

# %%
grey = beam.T  # a row is the mean of some samples
row_depths = depths.reshape(len(grey[0]), -1).mean(axis=1)
figure, axes = plt.subplots(1, 3, figsize=(11, 4.2), width_ratios=(1, 1.3, 1))
polar = {"aspect": "auto", "extent": (0, settings.scanlines, probe.depth_mm, 0), "cmap": "gray"}
axes[0].imshow(rendered.envelope, vmax=np.percentile(rendered.envelope, 99.8), **polar)
axes[0].set(title="Envelope", xlabel="scanline", ylabel="depth (mm)")
level = decibel(rendered.envelope[:, busiest] / settings.reference_level, -140)
axes[1].plot(depths, level, color="#999999", lw=0.5, label="envelope")
shown_db = (grey[busiest] / 255 - 1) * settings.dynamic_range_db
axes[1].plot(row_depths, shown_db, color="#0072b2", lw=0.5, label="with gain and noise, as displayed")
noise_db = settings.noise_level_db - 20 * np.log10(settings.reference_level)
gain_db = time_gain_db(depths, probe, settings.time_gain)
axes[1].plot(depths, noise_db + gain_db, color="k", ls="--", lw=0.8, label="noise with gain")
axes[1].set(title=f"Scanline {busiest}", xlabel="depth (mm)", ylabel="dB under white", xlim=(0, probe.depth_mm))
axes[1].set_ylim(-125, 10)
axes[1].legend(frameon=False, fontsize=8, loc="lower left")
axes[2].imshow(grey.T, vmin=0, vmax=255, **polar)
axes[2].set(title="Grey levels", xlabel="scanline")
plt.show()

# %% [markdown]
# ## 10. Scan conversion: the B-mode image
#
# The scanlines are placed in the fan and interpolated between their neighbours. The right picture shows the same
# frame in the data set of the study. The preset of the study has fewer pixels, fewer scanlines and a longer pulse, so
# that a laptop can train on it.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.7))
show(left, rendered.image, "At the paper's size, {} x {}".format(*settings.image_shape), vmin=0, vmax=255)
show(right, pairs.read("target", [frame])[0], "In the data set, {} x {}".format(*pairs.shape), vmin=0, vmax=255)
plt.show()

# %% [markdown]
# S, A and this image H are one pair of the data set. The networks learn to compute H from S and A.
# `docs/simulator.md` describes the model, its limits and its tests.
