"""Frames and segmentations as DICOM: ultrasound images, one a frame or a cine as one object, and DICOM SEG."""

import hashlib
from pathlib import Path

import numpy as np
import pydicom
from highdicom import AlgorithmIdentificationSequence
from highdicom.seg import SegmentAlgorithmTypeValues, Segmentation, SegmentationTypeValues, SegmentDescription
from highdicom.sr import CodedConcept
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.uid import ExplicitVRLittleEndian, UltrasoundImageStorage, UltrasoundMultiFrameImageStorage, generate_uid

from ablate.dataset.classes import Classes
from ablate.dataset.pairs import Pairs
from ablate.ultrasound import SIMULATOR_VERSION

Size = tuple[float, float]  # of a pixel: height and width, mm
_VERSION = f"simulator {SIMULATOR_VERSION}"
# The standard wants them, and nothing is known.
_EMPTY = (
    "PatientBirthDate",
    "PatientSex",
    "StudyDate",
    "StudyTime",
    "StudyID",
    "AccessionNumber",
    "ReferringPhysicianName",
    "Laterality",
)
_UTF_8 = "ISO_IR 192"
_FRAME_TIME = 0x00181063  # the tag of what tells frames of a cine apart


def write_dicom(pairs: Pairs, folder: Path, pixel_mm: Size, classes: Classes, imported: bool = False) -> None:
    """A file a frame, and in `segmentation` its labels as DICOM SEG; of `imported` ones it is not said who made them.

    UIDs are numbers from the name of the data set, which has its hash, the frame and its pixels: they stay the same.

    Parameters
    ----------
    pairs : Pairs
        Their targets are written.
    folder : Path
        Of the files; those of SEG lie in `segmentation` there.
    pixel_mm : Size
        Height and width of a pixel.
    classes : Classes
        What the segments are.
    imported : bool
        Whether another program made the images.
    """
    (folder / "segmentation").mkdir(parents=True, exist_ok=True)
    segments = [_segment(number, name, imported) for number, name in enumerate(classes.names, start=1)]
    for frame in range(len(pairs)):
        name = f"frame{frame:05d}.dcm"
        shown = pairs.stored("target", frame)
        image = _ultrasound(pairs.folder.name, frame, shown, pairs.mask(), pixel_mm)
        if imported:
            image.PatientName = "Unknown^Patient"
            image.DerivationDescription = "Imported by ablate from an image made elsewhere"
        image.SOPInstanceUID = _uid(pairs.folder.name, hashlib.sha256(shown.tobytes()).hexdigest(), str(frame))
        pydicom.dcmwrite(folder / name, image, enforce_file_format=True)
        segmentation = Segmentation(
            source_images=[image],
            pixel_array=classes.labels(frame),
            segmentation_type=SegmentationTypeValues.BINARY,
            segment_descriptions=segments,
            series_instance_uid=_uid(pairs.folder.name, "segmentations"),
            series_number=2,
            sop_instance_uid=_uid(image.SOPInstanceUID, "segmentation"),
            instance_number=frame + 1,
            software_versions=_VERSION,
            manufacturer="ablate",
            manufacturer_model_name="ablate",
            device_serial_number="none",
        )
        segmentation.SpecificCharacterSet = _UTF_8
        segmentation.PatientOrientation = []  # as of the image: not known
        segmentation.save_as(folder / "segmentation" / name)


def write_cine(path: Path, frames: np.ndarray, mask: np.ndarray, pixel_mm: Size, frame_ms: float) -> None:
    """Write images as one multi-frame object.

    Parameters
    ----------
    path : Path
        Of the file.
    frames : (n, H, W) uint8
        Grey levels of images of one size and place.
    mask : (H, W) bool
        The fan.
    pixel_mm : (float, float), mm
        Height and width of a pixel.
    frame_ms : float
        Time from one frame to the next.
    """
    cine = _ultrasound(path.parent.name, 0, frames, mask, pixel_mm)
    content = hashlib.sha256(np.ascontiguousarray(frames).tobytes() + repr((pixel_mm, frame_ms)).encode()).hexdigest()
    cine.SOPInstanceUID = _uid(content)
    cine.StudyInstanceUID = _uid(content, "study")
    cine.SeriesInstanceUID = _uid(content, "series")
    cine.SOPClassUID = UltrasoundMultiFrameImageStorage
    cine.FrameTime = frame_ms
    cine.FrameIncrementPointer = _FRAME_TIME
    pydicom.dcmwrite(path, cine, enforce_file_format=True)


def _ultrasound(known_by: str, number: int, pixels: np.ndarray, mask: np.ndarray, pixel_mm: Size) -> Dataset:
    """An ultrasound image with its region calibrated; pixels are (H, W) or, of several frames, (n, H, W)."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.SpecificCharacterSet = _UTF_8
    data.SOPClassUID = UltrasoundImageStorage
    data.SOPInstanceUID = _uid(known_by, str(number))
    data.StudyInstanceUID = _uid(known_by, "study")
    data.SeriesInstanceUID = _uid(known_by, "series")
    data.PatientName = "Simulated^Phantom"
    data.PatientID = _text(known_by)
    for name in _EMPTY:
        setattr(data, name, "")
    data.Modality = "US"
    data.Manufacturer = "ablate"
    data.SeriesDescription = _text(known_by)
    data.SoftwareVersions = _VERSION
    data.SeriesNumber = 1
    data.InstanceNumber = number + 1
    data.PatientOrientation = []
    data.ImageType = ["DERIVED", "PRIMARY"]
    data.DerivationDescription = "Simulated, no patient"
    data.SequenceOfUltrasoundRegions = [_region(mask, pixel_mm)]
    data.set_pixel_data(pixels, "MONOCHROME2", 8, generate_instance_uid=False)
    return data


def _region(mask: np.ndarray, pixel_mm: Size) -> Dataset:
    """The bounds of the fan, and the size of its pixels."""
    region = Dataset()
    region.RegionSpatialFormat = 1  # 2-D
    region.RegionDataType = 1  # tissue
    region.RegionFlags = 0
    inside = np.argwhere(mask)
    top, left = inside.min(axis=0).tolist()
    bottom, right = inside.max(axis=0).tolist()
    region.RegionLocationMinX0 = left
    region.RegionLocationMinY0 = top
    region.RegionLocationMaxX1 = right
    region.RegionLocationMaxY1 = bottom
    region.PhysicalUnitsXDirection = 3  # cm
    region.PhysicalUnitsYDirection = 3
    region.PhysicalDeltaX = pixel_mm[1] / 10
    region.PhysicalDeltaY = pixel_mm[0] / 10
    return region


def _segment(number: int, tissue: str, imported: bool) -> SegmentDescription:
    """A class as a segment, with a code of our own: its name, or a digest of one that is long or not ASCII."""
    name = _text(tissue) or f"label {number}"
    plain = name == tissue and name.isascii() and len(name) <= 16  # DICOM's limit
    code = name if plain else hashlib.sha256(tissue.encode()).hexdigest()[:16]
    kinds, step = SegmentAlgorithmTypeValues, codes.DCM.ImageProcessing
    made_by = ("unknown", step, "imported") if imported else ("ablate", step, _VERSION)
    return SegmentDescription(
        segment_number=number,
        segment_label=name,
        segmented_property_category=codes.SCT.AnatomicalStructure,
        segmented_property_type=CodedConcept(code, "99ABLATE", name),
        algorithm_type=kinds.SEMIAUTOMATIC if imported else kinds.AUTOMATIC,
        algorithm_identification=AlgorithmIdentificationSequence(*made_by),
    )


def _text(value: str) -> str:
    """A text as one value of DICOM: of at most 64 bytes, without controls, and without what separates values."""
    shown = "".join(letter if letter.isprintable() else " " for letter in value.replace("\\", "/"))
    return " ".join(shown.split()).encode()[:64].decode(errors="ignore").rstrip()


def _uid(*known_by: str) -> str:
    return str(generate_uid(entropy_srcs=list(known_by)))
