"""Probe sites, pairs on disk, and the crops that training sees."""

from ablate.dataset.contact_sheet import write_contact_sheet
from ablate.dataset.crops import CropLoader, Crops, CropSettings
from ablate.dataset.encoding import Encoding, label_values, network_inputs
from ablate.dataset.filling import fill_pairs, remove_damaged
from ablate.dataset.pairs import PAIRS_VERSION, DamagedShardError, Pairs, create_pairs, open_pairs
from ablate.dataset.png_folder import PngFolder, content_digest, validate_png_folder
from ablate.dataset.png_import import import_pairs, read_fan
from ablate.dataset.processes import end_with_parent
from ablate.dataset.simulate import Recipe, simulate_pairs
from ablate.dataset.sites import Dropped, Placement, Pose, place_probe, probe_poses, resample_grid
from ablate.dataset.split import Part, SplitBy, choose_frames, equally_spaced, split_frames

__all__ = [
    "PAIRS_VERSION",
    "CropLoader",
    "CropSettings",
    "Crops",
    "DamagedShardError",
    "Dropped",
    "Encoding",
    "Pairs",
    "Part",
    "Placement",
    "PngFolder",
    "Pose",
    "Recipe",
    "SplitBy",
    "choose_frames",
    "content_digest",
    "create_pairs",
    "end_with_parent",
    "equally_spaced",
    "fill_pairs",
    "import_pairs",
    "label_values",
    "network_inputs",
    "open_pairs",
    "place_probe",
    "probe_poses",
    "read_fan",
    "remove_damaged",
    "resample_grid",
    "simulate_pairs",
    "split_frames",
    "validate_png_folder",
    "write_contact_sheet",
]
