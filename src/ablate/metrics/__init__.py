"""PSNR, MAE, patch chi-square, Frechet and kernel distance, and the metrics of mechanism."""

from ablate.metrics.distances import frechet_distance, kernel_distance
from ablate.metrics.evaluation import IMAGE_METRICS, Pair, evaluate_image
from ablate.metrics.features import FEATURE_NAMES, speckle_features
from ablate.metrics.fidelity import mae, psnr
from ablate.metrics.inception import INCEPTION_SHA256, inception_features
from ablate.metrics.intervals import bootstrap_interval
from ablate.metrics.mechanism import mae_smooth, noise_sd, nyquist_excess, shadow_contrast
from ablate.metrics.patch_histograms import patch_chi2, patches_inside, rms

__all__ = [
    "FEATURE_NAMES",
    "IMAGE_METRICS",
    "INCEPTION_SHA256",
    "Pair",
    "bootstrap_interval",
    "evaluate_image",
    "frechet_distance",
    "inception_features",
    "kernel_distance",
    "mae",
    "mae_smooth",
    "noise_sd",
    "nyquist_excess",
    "patch_chi2",
    "patches_inside",
    "psnr",
    "rms",
    "shadow_contrast",
    "speckle_features",
]
