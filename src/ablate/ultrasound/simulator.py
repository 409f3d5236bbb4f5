"""The simulator: renders frames of a scene, from any pose, for one probe and one set of settings."""

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
import torch

from ablate.anatomy import Scene, bounds_mm, check_scene
from ablate.threads import side_by_side, without_teams
from ablate.ultrasound.attenuation import integral_attenuation
from ablate.ultrasound.echoes import Echoes, echoes_of
from ablate.ultrasound.frame import Beam, Frame
from ablate.ultrasound.imaging.bmode import Display, Prepared, Returned, SignalChain, means_of_rows
from ablate.ultrasound.imaging.compounding import shares
from ablate.ultrasound.imaging.lattice import body_lines, grain, pose_in_body
from ablate.ultrasound.imaging.point_spread import lateral_kernels, layer_weights
from ablate.ultrasound.media import plan_scene
from ablate.ultrasound.probe import check_pose, check_seed, fan_of
from ablate.ultrasound.settings import ConvexProbe, Probe, SimulatorSettings, TimeGain
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.surfaces.slices import contact_warning, plane_labels, scanline_labels, segment
from ablate.ultrasound.transport import lines
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.surface_maps import SurfaceMaps
from ablate.ultrasound.transport.tracing import Tracer

Make = Callable[["Simulator", np.ndarray], Any]  # of a pose in the geometry's world


class Simulator:
    """Renders a scene as a probe sees it.

    Rays and labels of the last pose are kept, so the same pose with another scatterer seed needs the signal chain only.

    Parameters
    ----------
    poses : iterable of (4, 4) float, optional
        Poses of the probe that will be rendered; structures out of reach from all of them are left out, and a pose
        that might see one of them is refused by a ValueError.
    beside : Simulator, optional
        Another simulator of the same scene. Its meshes are not checked again, and its triangles are used again where
        both leave out the same structures. The frames are the same without it.

    Attributes
    ----------
    left_out : tuple of str
        What the plan leaves out and why.
    mask : (H, W) bool
        The fan.

    Raises
    ------
    ValueError
        When a mesh is open, empty or not finite, the scene has more than 254 tissues, or a pose is not rigid.

    Examples
    --------
    >>> import numpy as np
    >>> import trimesh
    >>> from ablate.anatomy import Scene, Structure, load_tissues
    >>> from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
    >>> tissues = load_tissues()
    >>> box = trimesh.creation.box((200, 200, 100)).apply_translation((0, 0, 53))
    >>> scene = Scene((Structure(box, tissues["liver"]),), tissues["coupling_gel"], "a block of liver")
    >>> settings = SimulatorSettings.low_quality(scanlines=32, axial_samples=256, image_shape=(64, 89))
    >>> frame = Simulator(scene, ConvexProbe(), settings).render(np.eye(4), seed=0)
    >>> frame.image.shape, frame.envelope.shape
    ((64, 89), (256, 32))
    >>> np.unique(frame.segmentation).tolist()  # outside the fan, gel, liver
    [0, 1, 2]
    """

    def __init__(
        self,
        scene: Scene,
        probe: Probe | None = None,
        settings: SimulatorSettings | None = None,
        poses: Iterable[np.ndarray] | None = None,
        beside: "Simulator | None" = None,
    ) -> None:
        self.scene = scene
        self.probe = probe = probe or ConvexProbe()
        settings = settings or SimulatorSettings()
        settings.check_probe(probe)
        has_gpu = torch.cuda.is_available()
        if settings.device == "cuda" and not has_gpu:
            raise ValueError("device=cuda: this machine has no usable GPU, allowed are cpu and auto")
        if settings.device == "auto":
            settings = replace(settings, device="cuda" if has_gpu else "cpu")
        if settings.tgc is TimeGain.patient and settings.time_gain_db is None:
            raise ValueError("tgc=patient: a curve is needed, which with_patient_gain computes from poses")
        self.settings = settings
        if beside is None:
            check_scene(scene, probe.depth_mm)
        elif beside.scene is not scene:
            raise ValueError(f"beside: a simulator of scene {beside.scene.name!r}, allowed is one of the same scene")
        self._plan = plan_scene(scene, probe, settings, poses)
        self.left_out = self._plan.left_out
        bounds = bounds_mm(s.mesh for s in scene.structures)
        extent = fan_of(probe).reach_mm
        # Zero for every scene about the world's origin; float32 then serves scenes that are far from it.
        grid_mm = 10 ** math.ceil(math.log10(extent + float(np.linalg.norm(bounds[1] - bounds[0]))))
        self._origin_mm = grid_mm * np.rint(bounds.mean(axis=0) / grid_mm)
        own, theirs = ([id(s) for s in simulator._plan.structures] for simulator in (self, beside or self))
        if beside is not None and own == theirs and np.array_equal(beside._origin_mm, self._origin_mm):
            self._geometry: Geometry = beside._geometry.reaching(extent)
        else:
            self._geometry = Geometry(self._plan.structures, bounds, self._origin_mm, extent)
        # one way of two equal Gaussians is wider than both by sqrt(2)
        self._beam = torch.from_numpy(lateral_kernels(probe, settings, widen=math.sqrt(2)))
        self._aperture = Aperture(probe, settings)
        self._chain = SignalChain(scene.tissues, probe, settings)
        self._tracers = tuple(
            Tracer(self._geometry, self._plan, probe, replace(settings, path_seed=one.path_seed), one.angle_rad)
            for one in self._chain.sets
        )
        self._weights, self._pulse = layer_weights(probe, settings)[1], float(self._chain.spread.axial.sum())
        self._surface_maps = SurfaceMaps(self._geometry, self._plan, (self._beam, self._aperture), probe, settings)
        self._kept: dict[Make, tuple[bytes, Any]] = {}  # of the last pose
        self._warned: set[str] = set()

    @property
    def mask(self) -> np.ndarray:
        return self._chain.convert.mask.copy()

    @without_teams()
    def render(self, pose: np.ndarray, seed: int = 0, display: Display | None = None) -> Frame:
        """One frame; a ValueError when the pose is not rigid or the seed negative.

        Parameters
        ----------
        pose : (4, 4) float
            Rigid transform from probe to world, mm.
        seed : int
            Of the scatterers and the display's noise; the paths follow `settings.path_seed`.
        display : Display, optional
            What an operator sets of the picture; without it the picture follows the settings alone.
        """

        def maps() -> tuple[np.ndarray, np.ndarray, Beam]:
            segmentation, attenuation = self.maps(pose)
            beam = self.beam_maps(pose, of_angles=self.settings.compound_angles > 1)
            return segmentation, attenuation, replace(beam, grain=self.grain(pose, seed))

        # some steps of an image cannot be shared among threads
        image_and_maps = side_by_side(partial(self._image, pose, seed, display), maps)
        (image, envelope), (segmentation, attenuation, beam) = image_and_maps
        return Frame(
            segmentation=segmentation,
            attenuation=attenuation,
            image=self._chain.convert.to_image(image),
            mask=self.mask,
            envelope=np.ascontiguousarray(envelope.T, np.float32),
            beam=replace(beam, image=image),
            probe=self.probe,
            simulator=self.settings,
        )

    @without_teams()
    def image(self, pose: np.ndarray, seed: int = 0, display: Display | None = None) -> np.ndarray:
        """The image of `render`, (H, W) uint8, alone: the maps are not made."""
        return self._chain.convert.to_image(self.beam_image(pose, seed, display))

    def beam_image(self, pose: np.ndarray, seed: int = 0, display: Display | None = None) -> np.ndarray:
        """The image of `render` before scan conversion, (rows, scanlines) uint8."""
        return self._image(pose, seed, display)[0]

    def _image(self, pose: np.ndarray, seed: int, display: Display | None) -> tuple[np.ndarray, np.ndarray]:
        """The image, (rows, scanlines) uint8, and its envelope, (scanlines, samples)."""
        seed = check_seed(seed)
        pose = check_pose(pose)
        with without_teams(), torch.inference_mode():
            prepared = None if self._plan.anechoic else self._of(pose, Simulator._prepare)
            return self._chain.image(prepared, pose, seed, display)

    def echoes(self, pose: np.ndarray, seed: int = 0) -> Echoes:
        """What a simulator of your own is given of a pose; ValueErrors are those of `render`."""
        pose, seed = check_pose(pose), check_seed(seed)
        with without_teams(), torch.inference_mode():
            return echoes_of(self._chain, self._of(pose, Simulator._prepare), pose, seed)

    def maps(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Segmentation (H, W) uint8 and attenuation (H, W) float32; a ValueError when the pose is not rigid."""
        pose = check_pose(pose)
        with without_teams():
            makes = Simulator._tissue_maps, Simulator._pixel_labels
            beam, labels = side_by_side(*(partial(self._of, pose, make) for make in makes))
            return labels.copy(), self._chain.convert.to_image(beam[1])

    def beam_maps(self, pose: np.ndarray, of_surfaces: bool = True, of_angles: bool = False) -> Beam:
        """Segmentation, attenuation and, if asked for, other maps of a pose in beam space; without an image.

        Raises ValueError when the pose is not rigid.

        Parameters
        ----------
        pose : (4, 4) float
            Rigid transform from probe to world, mm.
        of_surfaces : bool
            Whether `interfaces` and `illumination` are made.
        of_angles : bool
            Whether `compound` is made.
        """
        pose = check_pose(pose)
        makes: dict[Make, tuple[str, ...]] = {
            Simulator._maps_of_surfaces: ("interfaces", "illumination") if of_surfaces else (),
            Simulator._tissue_maps: ("segmentation", "attenuation"),
            Simulator._attenuation_of_angles: ("compound",) if of_angles else (),
        }
        wanted = {make: names for make, names in makes.items() if names}
        with without_teams():
            maps = chain.from_iterable(side_by_side(*(partial(self._of, pose, make) for make in wanted)))
        names = chain.from_iterable(wanted.values())
        return Beam(**{name: values.copy() for name, values in zip(names, maps, strict=True)})

    def grain(self, pose: np.ndarray, seed: int = 0) -> np.ndarray:
        """The lattice of scatterers at a pose, (rows, scanlines, 2) complex64; ValueErrors are those of `render`."""
        with without_teams():
            return grain(pose, self.probe, self.settings, seed, self.scene.body)

    def _of(self, pose: np.ndarray, make: Make) -> Any:
        """What `make` gives for a pose in the geometry's world; it is kept until another pose comes."""
        kept = self._kept.get(make)
        if kept is None or kept[0] != pose.tobytes():
            self._plan.check_reach(pose)
            local = pose.copy()
            local[:3, 3] -= self._origin_mm
            kept = self._kept[make] = pose.tobytes(), make(self, local)
        return kept[1]

    def _pixel_labels(self, local: np.ndarray) -> np.ndarray:
        """S of the pixels, (H, W) uint8."""
        return segment(self._geometry, self._plan.tissue_of_owner, self.probe, self._chain.convert.mask, local)

    def _maps_of_surfaces(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._surface_maps(local)

    def _tissue_maps(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Segmentation and attenuation in beam space."""
        labels, settings = self._scanline_tissues(local), self.settings
        spacing_mm = self.probe.depth_mm / settings.axial_samples
        last = settings.axial_samples - 1
        each = min(settings.samples_per_row, settings.axial_samples)
        amplitude = integral_attenuation(labels, self._plan.media.loss_db_mm, spacing_mm, each)
        middles = np.minimum(np.arange(settings.beam_shape[0]) * each + each // 2, last)
        segmentation = np.ascontiguousarray(labels[:, middles].T) + np.uint8(1)
        return segmentation, np.ascontiguousarray(amplitude.T)

    def _attenuation_of_angles(self, local: np.ndarray) -> tuple[np.ndarray]:
        """The mean of the attenuation maps of all angles, of those that see a place, in beam space."""
        spacing_mm = self.probe.depth_mm / self.settings.axial_samples
        mean = np.zeros((self.settings.scanlines, self.settings.axial_samples), np.float32)
        for one, share in zip(self._chain.sets, shares(self._chain.sets), strict=True):
            labels = self._scanline_tissues(local, one.angle_rad)
            mean += share * one.taken(integral_attenuation(labels, self._plan.media.loss_db_mm, spacing_mm))
        return (np.ascontiguousarray(means_of_rows(mean, self.settings)),)

    def scanline_tissues(self, pose: np.ndarray) -> np.ndarray:
        """The tissue of each sample of the image plane's scanlines, (scanlines, samples) uint8: index in the scene's.

        Raises ValueError when the pose is not rigid.
        """
        labels: np.ndarray = self._of(check_pose(pose), Simulator._scanline_tissues)
        return labels.copy()

    def _scanline_tissues(self, local: np.ndarray, steered_rad: float = 0.0) -> np.ndarray:
        return plane_labels(self._geometry, self._plan.tissue_of_owner, self.probe, self.settings, local, steered_rad)

    def _prepare(self, local: np.ndarray) -> Prepared:
        """What the signal chain needs."""
        pose = local.copy()
        pose[:3, 3] += self._origin_mm
        in_body = body_lines(pose_in_body(pose, self.scene.body), self.probe, self.settings)
        traced = [self._returned(number, local) for number in range(len(self._tracers))]
        _, labels, ranges = traced[len(traced) // 2]
        words = contact_warning(labels, self.scene.tissues, self.probe)
        if words is not None and words not in self._warned:  # once a simulator, however many frames it renders
            self._warned.add(words)
            warnings.warn(words, stacklevel=4)
        return Prepared((*in_body, labels, ranges), tuple(returned for returned, _, _ in traced))

    def _returned(self, number: int, local: np.ndarray) -> tuple[Returned, np.ndarray, np.ndarray]:
        """What rays of a set of scanlines bring back; labels and ranges of these, as of `scanline_labels`."""
        probe, settings, plan, tracer = self.probe, self.settings, self._plan, self._tracers[number]
        bundle = tracer.at(local)
        labels, ranges = scanline_labels(self._geometry, plan, (bundle.starts, bundle.directions), probe, settings)
        nodes = lines.empty_nodes(labels, plan.media.anechoic, probe.depth_mm)
        echoes = tracer(bundle, nodes)
        level_db = lines.mean_level_db(nodes.amplitude, settings.rays, self._beam)
        gain_db, level_db = self._aperture.gain_and_level_db(level_db)
        surfaces, reverberation = lines.echo_lines(echoes, gain_db, nodes, self._weights, settings.rays, probe.depth_mm)
        clutter = lines.clutter_lines(reverberation, settings.axial_samples, self._chain.dtype, self._pulse)
        return self._chain.returned(number, level_db, surfaces, clutter), labels, ranges
